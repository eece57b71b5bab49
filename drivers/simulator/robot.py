"""A differential-drive (or tracked) robot: how it drives a path, and what its wheels report of it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator, ConfigDict, Field, with_config

from drivers.simulator.motion import Motion
from drivers.simulator.pursuit import CREEP_M_S, follow, rounded_path, speed_profile
from drivers.simulator.world import World
from mfslam import se2
from mfslam.config import WheelsConfig
from mfslam.types import FloatArray, MfslamError

_LONGEST_M, _LONGEST_S = 1e5, 2e5  # of a path between two pauses: what fits into memory
TICK_S = 0.01  # the twist of a driven motion is constant for this long


def _no_reader_settings(wheels: WheelsConfig) -> WheelsConfig:
    """Keys that only a reader of logs knows would change nothing here: refused."""
    for key in ("left_joint", "right_joint", "yaw_rate_rule", "left_reversed", "right_reversed"):
        if getattr(wheels, key) != WheelsConfig.model_fields[key].default:
            raise ValueError(f"{key} is a setting of `mfslam map`, a simulated robot has none")
    return wheels


_Positive = Annotated[float, Field(gt=0)]
_NotNegative = Annotated[float, Field(ge=0)]
_Error = Annotated[float, Field(gt=-1)]


@with_config(ConfigDict(allow_inf_nan=False))
@dataclass(frozen=True)
class RobotModel:
    """Limits of the drive, and the wheels: as the config would state them, and what is wrong with that."""

    wheels: Annotated[
        WheelsConfig,
        AfterValidator(_no_reader_settings),
        Field(description="The nominal geometry, known to whoever reads the log."),
    ] = field(default_factory=lambda: WheelsConfig(track_m=0.33, radius_left_m=0.077, radius_right_m=0.077))
    max_speed_m_s: Annotated[float, Field(ge=CREEP_M_S, description="Highest speed, m/s.")] = 3.0
    acceleration_m_s2: Annotated[_Positive, Field(description="Highest acceleration and braking, m/s^2.")] = (
        2.0
    )
    lateral_acceleration_m_s2: Annotated[
        _Positive, Field(description="Highest acceleration to the side: how fast it takes bends, m/s^2.")
    ] = 2.0
    max_yaw_rate_rad_s: Annotated[_Positive, Field(description="Highest yaw rate, rad/s.")] = 2.0
    yaw_acceleration_rad_s2: Annotated[_Positive, Field(description="Highest yaw acceleration, rad/s^2.")] = (
        8.0
    )
    odometry: Annotated[
        Literal["pose", "ticks", "angles", "none"],
        Field(
            description="What the log carries of the wheels: dead-reckoned poses, encoder ticks, wheel angles or none."
        ),
    ] = "pose"
    encoder_rate_hz: Annotated[
        Annotated[float, Field(gt=0)] | None,
        Field(description="Readings of the encoders, Hz. Null: one reading at each scan's stamp."),
    ] = 50.0
    radius_error_left: Annotated[
        _Error, Field(description="True radius of the left wheel = radius_left_m * (1 + this).")
    ] = 0.0
    radius_error_right: Annotated[
        _Error, Field(description="True radius of the right wheel = radius_right_m * (1 + this).")
    ] = 0.0
    track_error: Annotated[_Error, Field(description="True track = track_m * (1 + this).")] = 0.0
    slip_m_per_sqrt_m: Annotated[
        _NotNegative, Field(description="Random walk of each wheel over the way that it rolls, m per root m.")
    ] = 0.0
    gyro_rate_hz: Annotated[
        _NotNegative, Field(description="Readings of the gyro, Hz. 0: there is none.")
    ] = 0.0
    gyro_scale_error: Annotated[float, Field(description="Reading = (1 + this) yaw rate + bias + noise.")] = (
        0.0
    )
    gyro_bias_rad_s: Annotated[float, Field(description="Bias of the gyro, rad/s.")] = 0.0
    gyro_sigma_rad_s: Annotated[_NotNegative, Field(description="One-sigma noise of a reading, rad/s.")] = (
        0.002
    )
    compass_sigma_rad: Annotated[
        Annotated[float, Field(ge=0)] | None,
        Field(
            description="One-sigma noise of a heading, told with the gyro's readings, rad. Null: no compass."
        ),
    ] = None
    compass_bias_rad: Annotated[float, Field(description="Error of all headings, rad.")] = 0.0
    encoder_phase_s: Annotated[
        _NotNegative, Field(description="First reading of the encoders after the start, s.")
    ] = 0.0
    encoder_jitter_s: Annotated[
        _NotNegative,
        Field(
            description="One-sigma error of the stamps of encoder readings, s. Not of those at scans' stamps."
        ),
    ] = 0.0
    turning_track_factor: Annotated[
        _Positive,
        Field(
            description="Tracks slip in turns: they roll as wheels this much farther apart than the true track. "
            "1 for wheels."
        ),
    ] = 1.0
    turning_slip_m_per_sqrt_rad: Annotated[
        _NotNegative,
        Field(description="Random walk of each track over the turn of the robot, m per root rad."),
    ] = 0.0


ROBOTS: dict[str, RobotModel] = {
    "wheels": RobotModel(),
    "tracks": RobotModel(  # as the paper's: tracks, 256 pulses per turn
        wheels=WheelsConfig(radius_left_m=0.08, radius_right_m=0.08, track_m=0.4, ticks_per_turn=256),
        turning_track_factor=1.5,
        turning_slip_m_per_sqrt_rad=0.005,
        slip_m_per_sqrt_m=0.005,
    ),
}


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
    length_m = float(np.sum(np.hypot(*np.diff(points, axis=0).T)))
    if length_m > _LONGEST_M or length_m > _LONGEST_S * np.min(np.minimum(speeds, robot.max_speed_m_s)):
        raise MfslamError(
            f"{world.name}: a path of {length_m:.3g} m at {np.min(speeds):g} m/s: expected at most "
            f"{_LONGEST_M:g} m and {_LONGEST_S:g} s"
        )
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
    half_track = 0.5 * robot.wheels.track_m * (1.0 + robot.track_error) * robot.turning_track_factor
    rolled = np.diff(
        np.stack([forward - half_track * turned, forward + half_track * turned], axis=-1), axis=0
    )
    rolled += rng.standard_normal(rolled.shape) * robot.slip_m_per_sqrt_m * np.sqrt(np.abs(rolled))
    if robot.turning_slip_m_per_sqrt_rad > 0.0:
        walk = robot.turning_slip_m_per_sqrt_rad * np.sqrt(np.abs(np.diff(turned)))
        rolled += rng.standard_normal(rolled.shape) * walk[:, None]
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
