"""What the wheels say: a dead-reckoned track, its motion between instants and its honest noise."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from mfslam.config import OdometryConfig
from mfslam.kernels import poses, tracks, wheel_steps
from mfslam.types import FloatArray

MIN_TWIST_WINDOW_S = 0.25
RESTART_AT, RESTART_FROM_M, RESTART_FROM_RAD = 1e-2, 0.5, 0.5  # at the origin (m, rad), from far off


class OdometryTrack:
    """Dead-reckoned poses in log order. Stamps that go backwards are held at the latest one seen."""

    def __init__(self, config: OdometryConfig | None = None) -> None:
        self._config = config or OdometryConfig()
        self._count = 0
        self._times_s, self._odom_T_body = np.empty(64), np.empty((64, 3))  # doubled when they are full
        self.first_s = self.last_s = 0.0
        self.backwards_s = 0.0  # largest step back of a stamp
        self.has_moved = False
        self._breaks: list[tuple[float, float]] = []  # knots before and after each jump of the counters

    def add(self, time_s: float, odom_T_body: FloatArray, pause_s: float = 0.0, broken: bool = False) -> None:
        """The next pose. ``pause_s``: what may have passed before it beyond ``time_s``; ``broken``: how the
        robot came there is not known."""
        count = self._count
        if count == 0:
            self.first_s = time_s
        else:
            if time_s < self.last_s:
                self.backwards_s = max(self.backwards_s, self.last_s - time_s)
                time_s = self.last_s
            if not self.has_moved:
                self.has_moved = bool(np.max(np.abs(odom_T_body - self._odom_T_body[0])) > 1e-3)
            # stamps in bursts are no proof of speed: at least twice the usual time between two readings
            usual_s = (time_s - self.first_s) / count
            span_s = max(time_s - self.last_s, 2.0 * usual_s, 0.05) + pause_s
            x, y, theta = poses.between(self._odom_T_body[count - 1], odom_T_body).tolist()
            if broken or not is_plausible((x / span_s, y / span_s, theta / span_s), self._config):
                self._breaks.append((self.last_s, time_s))
        if count == len(self._times_s):
            self._times_s = np.concatenate([self._times_s, np.empty_like(self._times_s)])
            self._odom_T_body = np.concatenate([self._odom_T_body, np.empty_like(self._odom_T_body)])
        self._odom_T_body[count] = odom_T_body
        self._times_s[count] = self.last_s = time_s
        self._count = count + 1

    @property
    def times_s(self) -> FloatArray:
        """(N,) instants of the poses so far."""
        return self._times_s[: self._count]

    @property
    def odom_T_body(self) -> FloatArray:
        """(N, 3) the poses so far."""
        return self._odom_T_body[: self._count]

    def __len__(self) -> int:
        return self._count

    def pose_at(self, time_s: float) -> FloatArray:
        """Pose on the track (3,), constant twist between knots, held at both ends (eq. 16)."""
        return np.asarray(tracks.pose_at(self._times_s, self._odom_T_body, self._count, time_s))

    def is_broken(self, start_s: float, end_s: float) -> bool:
        """Whether the counters jump between two instants."""
        return any(before < end_s and after > start_s for before, after in self._breaks[-8:])

    def twist_over(self, start_s: float, end_s: float, config: OdometryConfig) -> FloatArray:
        """Mean body twist (3,) over an interval, widened where stamps are too coarse or lie."""
        if self._count < 2:
            return np.zeros(3)
        window_s = max(MIN_TWIST_WINDOW_S, 2.0 * self.backwards_s)
        pad_s = max(0.0, 0.5 * (window_s - (end_s - start_s)))
        t0 = min(max(start_s - pad_s, self.first_s), self.last_s)
        t1 = max(min(end_s + pad_s, self.last_s), self.first_s)
        if self._breaks:
            t0, t1 = self._beside_breaks(t0, t1)
        if t1 - t0 < 1e-3:
            return np.zeros(3)
        twist: FloatArray = tracks.mean_twist(self._times_s, self._odom_T_body, self._count, t0, t1)
        return twist if is_plausible(twist.tolist(), config) else np.zeros(3)

    def _beside_breaks(self, t0: float, t1: float) -> tuple[float, float]:
        """The interval moved to one side of a jump within it."""
        length_s, middle_s = t1 - t0, 0.5 * (t0 + t1)
        for before, after in self._breaks[-8:]:
            if before < t1 and after > t0:
                if middle_s < after:
                    return max(before - length_s, self.first_s), before
                return after, min(after + length_s, self.last_s)
        return t0, t1


def is_plausible(twist: FloatArray | Sequence[float], config: OdometryConfig) -> bool:
    """Whether wheels can have turned so fast; otherwise it is a jump of the counters."""
    return (
        math.hypot(twist[0], twist[1]) <= config.max_speed_m_s and abs(twist[2]) <= config.max_yaw_rate_rad_s
    )


def begins_anew(before: FloatArray, told: FloatArray) -> bool:
    """Whether wheels that stood at ``before`` (3,) were set back to where their dead reckoning begins."""
    x, y, theta = told.tolist()
    if abs(x) >= RESTART_AT or abs(y) >= RESTART_AT or abs(theta) >= RESTART_AT:
        return False
    return math.hypot(before[0], before[1]) > RESTART_FROM_M or abs(float(before[2])) > RESTART_FROM_RAD


def is_jump(step: FloatArray, dt_s: float, config: OdometryConfig) -> bool:
    """Whether a step between two scans is farther than the robot can have driven; stamps of scans that
    come in bursts are given the benefit of the doubt."""
    span_s = max(dt_s, 0.3)
    return (
        math.hypot(step[0], step[1]) > config.max_speed_m_s * span_s
        or abs(step[2]) > config.max_yaw_rate_rad_s * span_s
    )


def step_sigmas(step: FloatArray, step_noise: FloatArray) -> FloatArray:
    """One-sigma noise (3,) of a wheel motion ``step`` (3,) in its own frame: grows with the distance and
    the turn, sideways slip included (`OdometryConfig.step_noise`)."""
    return np.asarray(wheel_steps.step_sigmas(step, step_noise))
