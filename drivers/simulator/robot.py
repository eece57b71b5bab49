"""A differential-drive (or tracked) robot: how it drives a path, and what its wheels report of it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from drivers.simulator.motion import Motion
from drivers.simulator.pursuit import follow, rounded_path, speed_profile
from drivers.simulator.world import World
from mfslam import se2
from mfslam.config import WheelsConfig
from mfslam.types import FloatArray, MfslamError

TICK_S = 0.01  # the twist of a driven motion is constant for this long


@dataclass(frozen=True)
class RobotModel:
    """Limits of the drive, and the wheels: as the config would state them, and what is wrong with that.

    ``wheels``: the nominal geometry, known to whoever reads the log. True radius = nominal * (1 + error),
    track likewise. ``slip_m_per_sqrt_m``: random walk of each wheel. ``odometry``: what the log carries:
    dead-reckoned poses, encoder ticks, wheel angles or nothing. ``encoder_rate_hz`` None: one reading at
    each scan's stamp. Gyro: reading = (1 + scale) rate + bias + noise. Compass likewise, without scale.
    """

    wheels: WheelsConfig = field(
        default_factory=lambda: WheelsConfig(track_m=0.33, radius_left_m=0.077, radius_right_m=0.077)
    )
    max_speed_m_s: float = 3.0
    acceleration_m_s2: float = 2.0
    lateral_acceleration_m_s2: float = 2.0
    max_yaw_rate_rad_s: float = 2.0
    yaw_acceleration_rad_s2: float = 8.0
    odometry: Literal["pose", "ticks", "angles", "none"] = "pose"
    encoder_rate_hz: float | None = 50.0
    radius_error_left: float = 0.0
    radius_error_right: float = 0.0
    track_error: float = 0.0
    slip_m_per_sqrt_m: float = 0.0
    gyro_rate_hz: float = 0.0
    gyro_scale_error: float = 0.0
    gyro_bias_rad_s: float = 0.0
    gyro_sigma_rad_s: float = 0.002
    compass_sigma_rad: float | None = None
    compass_bias_rad: float = 0.0


def drive(world: World, robot: RobotModel, rest_s: float = 0.5) -> Motion:
    """The robot drives the world's path, standing ``rest_s`` at the start and the end.

    Raises MfslamError when there is no path or the robot cannot follow it.
    """
    if len(world.path_m) < 2:
        raise MfslamError(f"{world.name}: expected at least two `path` points to drive")
    pose = world.start
    twists = [_rest(rest_s)]
    first = 0
    stops = [i for i, pause in enumerate(world.pauses_s) if pause > 0.0 and i < len(world.path_m) - 1]
    for last in [*stops, len(world.path_m) - 1]:
        if last > first:
            leg = _drive_leg(world, robot, pose, first, last)
            twists.append(leg)
            pose = Motion.from_twists(np.full(len(leg), TICK_S), leg, pose).world_T_body[-1]
        if world.pauses_s[last] > 0.0:
            twists.append(_rest(float(world.pauses_s[last])))
        first = last
    twists.append(_rest(rest_s))
    held = np.concatenate(twists)
    return Motion.from_twists(np.full(len(held), TICK_S), held, world.start)


def _rest(seconds: float) -> FloatArray:
    return np.zeros((max(round(seconds / TICK_S), 1), 3))


def _drive_leg(world: World, robot: RobotModel, pose: FloatArray, first: int, last: int) -> FloatArray:
    points, speeds = world.path_m[first : last + 1], world.speeds_m_s[first : last + 1]
    if not np.any(np.diff(points, axis=0)):
        return np.zeros((0, 3))
    path, limits = rounded_path(points, np.minimum(speeds, robot.max_speed_m_s))
    s, speed = speed_profile(
        path,
        limits,
        robot.acceleration_m_s2,
        robot.lateral_acceleration_m_s2,
        robot.max_yaw_rate_rad_s,
        robot.yaw_acceleration_rad_s2,
    )
    patience_s = 60.0 + 3.0 * float(np.sum(np.diff(s) / np.maximum(speed[:-1], 0.1)))
    most = math.ceil(patience_s / TICK_S)
    twists = follow(
        path,
        s,
        speed,
        pose,
        TICK_S,
        robot.acceleration_m_s2,
        robot.max_yaw_rate_rad_s,
        robot.yaw_acceleration_rad_s2,
        most,
    )
    if len(twists) == most:
        x, y = points[-1]
        raise MfslamError(
            f"{world.name}: the robot never arrives at path point ({x:g}, {y:g}): "
            "give the path wider turns or the robot more yaw rate"
        )
    return np.asarray(twists)


def wheel_angles(
    motion: Motion, robot: RobotModel, times_s: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """Angles (N, 2), rad, that the left and right wheels have turned since ``times_s[0]``, slip included."""
    forward, turned = motion.travel(times_s)
    half_track = 0.5 * robot.wheels.track_m * (1.0 + robot.track_error)
    rolled = np.diff(
        np.stack([forward - half_track * turned, forward + half_track * turned], axis=-1), axis=0
    )
    rolled += rng.standard_normal(rolled.shape) * robot.slip_m_per_sqrt_m * np.sqrt(np.abs(rolled))
    radii = np.array(
        [
            robot.wheels.radius_left_m * (1.0 + robot.radius_error_left),
            robot.wheels.radius_right_m * (1.0 + robot.radius_error_right),
        ]
    )
    return np.concatenate([np.zeros((1, 2)), np.cumsum(rolled / radii, axis=0)])


def encoder_ticks(angles_rad: FloatArray, wheels: WheelsConfig) -> FloatArray:
    """Whole ticks (N, 2) of wheel angles (N, 2)."""
    return np.floor(angles_rad * (wheels.ticks_per_turn / (2.0 * np.pi)) + 0.5)


def dead_reckoning(ticks: FloatArray, wheels: WheelsConfig) -> FloatArray:
    """odom_T_body (N, 3) from ticks (N, 2) by the nominal geometry, exact arcs (eqs. 7-13)."""
    rolled = np.diff(ticks, axis=0) * (2.0 * np.pi / wheels.ticks_per_turn)
    rolled *= np.array([wheels.radius_left_m, wheels.radius_right_m])
    forward = 0.5 * (rolled[:, 0] + rolled[:, 1])
    turned = (rolled[:, 1] - rolled[:, 0]) / wheels.track_m
    steps = se2.exp(np.stack([forward, np.zeros_like(forward), turned], axis=-1))
    heading = np.concatenate([[0.0], np.cumsum(turned)])
    c, s = np.cos(heading[:-1]), np.sin(heading[:-1])
    x = np.concatenate([[0.0], np.cumsum(c * steps[:, 0] - s * steps[:, 1])])
    y = np.concatenate([[0.0], np.cumsum(s * steps[:, 0] + c * steps[:, 1])])
    return np.stack([x, y, se2.wrap(heading)], axis=-1)
