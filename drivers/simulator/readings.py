"""What wheels, gyro and compass put into the log."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from drivers.simulator.faults import (
    Faults,
    awake,
    clock_shift_ns,
    counted_anew,
    displaced,
    outside,
    reckoned_anew,
)
from drivers.simulator.motion import Motion
from drivers.simulator.robot import RobotModel, dead_reckoning, encoder_ticks, wheel_angles
from mfslam import se2
from mfslam.types import BoolArray, FloatArray, Imu, IntArray, Message, Odometry, WheelAngles, WheelTicks

Timed = tuple[int, Message]  # when it arrives, ns by the wheels' clock


def seconds_since(start_ns: int, stamps_ns: IntArray) -> FloatArray:
    """Seconds (...) from the start; int stamps are subtracted first, so that it is exact."""
    since = np.asarray(stamps_ns, dtype=np.int64) - start_ns
    return since.astype(np.float64) * 1e-9


def wheel_messages(
    motion: Motion,
    robot: RobotModel,
    faults: Faults,
    scan_stamps_ns: IntArray,
    scan_arrivals_ns: IntArray,
    start_ns: int,
    rng: np.random.Generator,
    jitter_rng: np.random.Generator,
) -> tuple[list[Timed], FloatArray | None]:
    """Wheel messages, and odom_T_body (S, 3) at the scans where the log carries poses."""
    if robot.odometry == "none":
        return [], None
    own = np.array([start_ns], dtype=np.int64)
    if robot.encoder_rate_hz is not None:
        own = start_ns + _reading_ns(motion, robot.encoder_rate_hz, robot.encoder_phase_s)
    read = np.unique(np.concatenate([own, scan_stamps_ns]))
    times = seconds_since(start_ns, read)
    angles = wheel_angles(motion, robot, times, rng)
    ticks = encoder_ticks(angles, robot.wheels)
    told = np.isin(read, scan_stamps_ns if robot.encoder_rate_hz is None else own)
    if robot.odometry == "pose":  # what a scan carries itself, the stream must not lack
        told |= np.isin(read, scan_stamps_ns)
    told &= outside(times, faults.odometry_gaps_s) & awake(times, times, faults)
    stamps = read + clock_shift_ns(times, faults)
    if robot.encoder_jitter_s > 0.0:
        noise_ns = np.rint(jitter_rng.normal(0.0, robot.encoder_jitter_s * 1e9, len(read))).astype(np.int64)
        stamps = stamps + np.where(np.isin(read, scan_stamps_ns), 0, noise_ns)
    messages: list[Message]
    if robot.odometry == "ticks":
        rows = _pick(stamps, counted_anew(ticks, times, faults), told)
        messages = [WheelTicks(t, int(a), int(b)) for t, (a, b) in rows]
        poses = None
    elif robot.odometry == "angles":
        rows = _pick(stamps, counted_anew(angles, times, faults), told)
        messages = [WheelAngles(t, float(a), float(b)) for t, (a, b) in rows]
        poses = None
    else:
        poses = displaced(dead_reckoning(ticks, robot.wheels), times, faults.odometry_jumps)
        poses = reckoned_anew(poses, times, faults)
        messages = [Odometry(t, pose) for t, pose in _pick(stamps, poses, told)]
        poses = poses[np.searchsorted(read, scan_stamps_ns)]
    arrivals = read.copy()
    if robot.encoder_rate_hz is None and faults.spoils_stamps:  # readings made for a scan come with it
        arrivals[np.searchsorted(read, scan_stamps_ns)] = scan_arrivals_ns
    return list(zip(arrivals[told].tolist(), messages, strict=True)), poses


def _reading_ns(motion: Motion, rate_hz: float, phase_s: float = 0.0) -> IntArray:
    """Instants of readings at an even rate, ns from the start, the first at ``phase_s``."""
    count = max(math.floor((motion.duration_s - phase_s) * rate_hz + 1e-6) + 1, 0)
    return np.asarray(np.rint(phase_s * 1e9 + np.arange(count) * (1e9 / rate_hz)).astype(np.int64))


def _pick(stamps: IntArray, rows: FloatArray, told: BoolArray) -> Iterator[tuple[int, FloatArray]]:
    return zip(stamps[told].tolist(), rows[told], strict=True)


def gyro_messages(
    motion: Motion, robot: RobotModel, faults: Faults, start_ns: int, rng: np.random.Generator
) -> list[Timed]:
    """Yaw rates, with headings where there is a compass."""
    if robot.gyro_rate_hz <= 0.0:
        return []
    since_ns = _reading_ns(motion, robot.gyro_rate_hz)
    times = seconds_since(0, since_ns)
    noise = rng.standard_normal((len(times), 2))
    rates = motion.twist_at(times)[:, 2] * (1.0 + robot.gyro_scale_error) + robot.gyro_bias_rad_s
    rates = rates + noise[:, 0] * robot.gyro_sigma_rad_s
    sigma = robot.compass_sigma_rad
    headings = se2.wrap(motion.at(times)[:, 2] + robot.compass_bias_rad + noise[:, 1] * (sigma or 0.0))
    read = start_ns + since_ns
    told = awake(times, times, faults)
    stamps = (read + clock_shift_ns(times, faults))[told].tolist()
    yaws: list[float | None] = [None] * len(stamps) if sigma is None else list(headings[told].tolist())
    messages = [Imu(t, w, yaw) for t, w, yaw in zip(stamps, rates[told].tolist(), yaws, strict=True)]
    return list(zip(read[told].tolist(), messages, strict=True))
