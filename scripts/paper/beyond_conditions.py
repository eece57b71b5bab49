"""Beyond the paper: the drives, one factor changed at a time, and the worlds that have room for them."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np

from drivers.simulator import (
    LaserModel,
    Motion,
    RobotModel,
    World,
    drive,
    laser_model,
    load_world,
    parse_world,
)
from mfslam.config import WheelsConfig
from mfslam.types import FloatArray

HALL_M = (46.0, 24.0)
STRAIGHT_M, BEND_M = 20.0, 6.0  # of the lap: two straights, two half circles
LAP_M = 2.0 * STRAIGHT_M + 2.0 * math.pi * BEND_M
OVERLAP_M = 12.0  # the end of a drive goes once more over its beginning
ACCELERATION_M_S2, LATERAL_M_S2 = 4.0, 6.5
YAW_RATE_RAD_S, YAW_ACCELERATION_RAD_S2 = 4.0, 8.0
SPINS = 4
RAMP_S, TURN_S, REST_S = 0.5, 1.5, 0.5  # of one turn of the ramps


@dataclass(frozen=True)
class Condition:
    """One drive. Radius and track errors are shares; the delay is of the laser's stamps against the wheels'.

    ``drive``: "lap" goes round the hall at ``speed_m_s``; "spins" turns in place at ``yaw_rate_rad_s`` every
    few metres on the way, both ways; "surge" goes straight on at ``speed_m_s`` on average, speeding up and
    braking at ``surge_m_s2``; "ramps" stands in an office and turns left and right by turns, from rest to
    ``yaw_rate_rad_s`` within half a second. ``share``: of the lap that is driven, 1 with loop closure.
    """

    drive: Literal["lap", "spins", "surge", "ramps"] = "lap"
    speed_m_s: float = 3.0
    yaw_rate_rad_s: float = 1.0
    surge_m_s2: float = 4.0
    rate_hz: float = 10.0
    delay_s: float = 0.0
    delay_known: bool = False
    ticks_per_turn: int = 1024
    slip_m_per_sqrt_m: float = 0.001
    radius_error: float = 0.01
    track_error: float = 0.01
    share: float = 1.0
    seed: int = 1


@lru_cache(maxsize=4)
def hall(share: float = 1.0) -> World:
    """A hall of 46 m by 24 m with a block of shelves in its middle and a lane of 6 m around it; niches, pillars and
    crates along the walls, all of different sizes. The path is a lap (or a ``share`` of it) and a little more."""
    rng = np.random.default_rng(6)
    width, depth = HALL_M
    lines = [f"wall 0 0 {width} 0 {width} {depth} 0 {depth} 0 0"]
    for x in np.arange(2.5, width - 2.0, 3.5):
        for wall in (0.0, depth):
            inward = 1.0 if wall == 0.0 else -1.0
            w, d = rng.uniform(0.6, 2.2), rng.uniform(0.3, 1.4)
            lines.append(f"box {x + rng.uniform(-0.6, 0.6):.2f} {wall + inward * d / 2:.2f} {w:.2f} {d:.2f}")
    for y in np.arange(4.0, depth - 3.0, 4.0):
        for x in (0.0, width):
            inward = 1.0 if x == 0.0 else -1.0
            lines.append(
                f"pillar {x + inward * rng.uniform(0.3, 1.2):.2f} {y:.2f} {rng.uniform(0.2, 0.5):.2f}"
            )
    for x in np.arange(14.0, width - 13.0, 3.0):  # shelves with gaps that one sees through
        w, d = rng.uniform(1.2, 2.4), rng.uniform(2.5, 6.0)
        turn = rng.uniform(-6.0, 6.0)
        lines.append(f"box {x:.2f} {depth / 2 + rng.uniform(-0.8, 0.8):.2f} {w:.2f} {d:.2f} {turn:.1f}")
    lines += [f"path {x:.3f} {y:.3f} 10" for x, y in lap_points(share)]
    return parse_world("\n".join(lines), "hall for high speed")


def lap_points(share: float) -> FloatArray:
    """Points (N, 2) every half metre round the hall, anticlockwise from the middle of a straight."""
    length_m = LAP_M + OVERLAP_M if share >= 1.0 else share * LAP_M
    s = np.mod(np.arange(0.0, length_m, 0.5) + 0.5 * STRAIGHT_M, LAP_M)
    half_lap = 0.5 * LAP_M
    along, side = np.mod(s, half_lap), np.where(s < half_lap, 1.0, -1.0)
    angle = np.maximum(along - STRAIGHT_M, 0.0) / BEND_M
    x = np.minimum(along, STRAIGHT_M) - 0.5 * STRAIGHT_M + BEND_M * np.sin(angle)
    y = -BEND_M * np.cos(angle)
    return np.stack([0.5 * HALL_M[0] + side * x, 0.5 * HALL_M[1] + side * y], axis=-1)


def place(condition: Condition) -> World:
    """The world of a condition."""
    return load_world("office") if condition.drive == "ramps" else hall(condition.share)


def robot(condition: Condition) -> RobotModel:
    """A robot strong enough for 6 m/s and 4 rad/s, with the wheels' faults of the condition."""
    return RobotModel(
        wheels=WheelsConfig(
            radius_left_m=0.08, radius_right_m=0.08, track_m=0.35, ticks_per_turn=condition.ticks_per_turn
        ),
        max_speed_m_s=condition.speed_m_s,
        acceleration_m_s2=ACCELERATION_M_S2,
        lateral_acceleration_m_s2=LATERAL_M_S2,
        max_yaw_rate_rad_s=YAW_RATE_RAD_S,
        yaw_acceleration_rad_s2=YAW_ACCELERATION_RAD_S2,
        radius_error_left=-condition.radius_error,
        radius_error_right=-condition.radius_error,
        track_error=condition.track_error,
        slip_m_per_sqrt_m=condition.slip_m_per_sqrt_m,
    )


def motion(condition: Condition) -> Motion:
    """The true motion of a condition."""
    world = place(condition)
    if condition.drive == "lap":
        return drive(world, robot(condition))
    if condition.drive == "ramps":
        x, y, yaw = world.start.tolist()
        return ramps(turns(condition), (x, y, yaw))
    legs = spins(condition) if condition.drive == "spins" else surges(condition)
    rest = [(0.5, 0.0, 0.0, 0.0, 0.0)]
    start = (0.5 * (HALL_M[0] - STRAIGHT_M) - 2.0, 0.5 * HALL_M[1] - BEND_M, 0.0)
    return ramps([*rest, *legs, *rest], start)


def ramps(legs: list[tuple[float, float, float, float, float]], start: tuple[float, float, float]) -> Motion:
    """Legs of (duration s, speed from, speed to, yaw rate from, yaw rate to), linear within, in steps of 5 ms."""
    durations, twists = [], []
    for seconds, v0, v1, w0, w1 in legs:
        n = max(1, round(seconds / 0.005))
        middle = (np.arange(n) + 0.5) / n
        twists.append(np.stack([v0 + (v1 - v0) * middle, np.zeros(n), w0 + (w1 - w0) * middle], axis=-1))
        durations.append(np.full(n, seconds / n))
    return Motion.from_twists(np.concatenate(durations), np.concatenate(twists), start)


def spins(condition: Condition) -> list[tuple[float, float, float, float, float]]:
    """Drive 4 m at 1 m/s and turn in place, left and right by turns; once round each time, so that the way stays straight."""
    rate = condition.yaw_rate_rad_s
    ramp_s = rate / YAW_ACCELERATION_RAD_S2
    turn_s = 2.0 * math.pi / rate - ramp_s
    legs = []
    for n in range(max(1, round(SPINS * condition.share))):
        w = rate if n % 2 == 0 else -rate
        legs += [(0.25, 0.0, 1.0, 0.0, 0.0), (3.0, 1.0, 1.0, 0.0, 0.0), (0.25, 1.0, 0.0, 0.0, 0.0)]
        legs += [(ramp_s, 0.0, 0.0, 0.0, w), (turn_s, 0.0, 0.0, w, w), (ramp_s, 0.0, 0.0, w, 0.0)]
    return legs


def turns(condition: Condition) -> list[tuple[float, float, float, float, float]]:
    """Turn in place, left and right by turns, with a rest after each."""
    legs = [(1.0, 0.0, 0.0, 0.0, 0.0)]
    for n in range(max(1, round(SPINS * condition.share))):
        w = condition.yaw_rate_rad_s if n % 2 == 0 else -condition.yaw_rate_rad_s
        legs += [(RAMP_S, 0.0, 0.0, 0.0, w), (TURN_S, 0.0, 0.0, w, w), (RAMP_S, 0.0, 0.0, w, 0.0)]
        legs.append((REST_S, 0.0, 0.0, 0.0, 0.0))
    return [*legs, (1.0, 0.0, 0.0, 0.0, 0.0)]


def surges(condition: Condition) -> list[tuple[float, float, float, float, float]]:
    """Speed between half and one and a half times the mean, up and down at constant acceleration, there and back."""
    mean, a = condition.speed_m_s, condition.surge_m_s2
    low, high = 0.5 * mean, 1.5 * mean
    period_s = (high - low) / a
    cycles = max(1, int(14.0 / (2.0 * period_s * mean)))
    legs = []
    for sign in (1.0, -1.0) * max(1, round(2 * condition.share)):
        start_s = low / ACCELERATION_M_S2
        legs.append((start_s, 0.0, sign * low, 0.0, 0.0))
        for _ in range(cycles):
            legs += [
                (period_s, sign * low, sign * high, 0.0, 0.0),
                (period_s, sign * high, sign * low, 0.0, 0.0),
            ]
        legs.append((start_s, sign * low, 0.0, 0.0, 0.0))
    return legs


def laser(condition: Condition) -> LaserModel:
    """A 360 deg laser of 20 m that turns at the condition's rate: a scan takes the whole turn."""
    model = laser_model("generic", (0.1, 0.0, 0.0))
    stretch = 1.0 / (condition.rate_hz * model.period_s)
    true = dataclasses.replace(model.laser, offsets_s=model.laser.offsets_s * stretch)
    told = true
    if condition.delay_known:
        told = dataclasses.replace(true, offsets_s=true.offsets_s - condition.delay_s)
    return dataclasses.replace(
        model, laser=true, period_s=1.0 / condition.rate_hz, reported=told, stamp_delay_s=condition.delay_s
    )
