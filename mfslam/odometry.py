"""What the wheels say: a dead-reckoned track, its motion between instants and its honest noise."""

from __future__ import annotations

import bisect
import math
from array import array

import numpy as np

from mfslam.config import OdometryConfig
from mfslam.kernels import poses
from mfslam.types import FloatArray

MIN_TWIST_WINDOW_S = 0.25
RESTART_AT, RESTART_FROM_M, RESTART_FROM_RAD = 1e-2, 0.5, 0.5  # at the origin (m, rad), from far off
DISTRUSTED_SHARE = 1e-4  # of the information of a step that the scans contradict


class OdometryTrack:
    """Dead-reckoned poses in log order. Stamps that go backwards are held at the latest one seen."""

    def __init__(self, config: OdometryConfig | None = None) -> None:
        self._config = config or OdometryConfig()
        self.times_s = array("d")
        self._odom_T_body = np.empty((64, 3))
        self.backwards_s = 0.0  # largest step back of a stamp
        self.has_moved = False
        self._breaks: list[tuple[float, float]] = []  # knots before and after each jump of the counters

    def add(self, time_s: float, odom_T_body: FloatArray, pause_s: float = 0.0, broken: bool = False) -> None:
        """The next pose. ``pause_s``: what may have passed before it beyond ``time_s``; ``broken``: how the
        robot came there is not known."""
        if self.times_s and time_s < self.times_s[-1]:
            self.backwards_s = max(self.backwards_s, self.times_s[-1] - time_s)
            time_s = self.times_s[-1]
        if self.times_s:
            if not self.has_moved:
                self.has_moved = bool(np.max(np.abs(odom_T_body - self.odom_T_body[0])) > 1e-3)
            # stamps in bursts are no proof of speed: at least twice the usual time between two readings
            usual_s = (time_s - self.times_s[0]) / len(self.times_s)
            span_s = max(time_s - self.times_s[-1], 2.0 * usual_s, 0.05) + pause_s
            x, y, theta = poses.between(self.odom_T_body[-1], odom_T_body).tolist()
            if broken or not is_plausible((x / span_s, y / span_s, theta / span_s), self._config):
                self._breaks.append((self.times_s[-1], time_s))
        if len(self) == len(self._odom_T_body):
            self._odom_T_body = np.concatenate([self._odom_T_body, np.empty_like(self._odom_T_body)])
        self._odom_T_body[len(self)] = odom_T_body
        self.times_s.append(time_s)

    @property
    def odom_T_body(self) -> FloatArray:
        """(N, 3) the poses so far."""
        return self._odom_T_body[: len(self.times_s)]

    def __len__(self) -> int:
        return len(self.times_s)

    def pose_at(self, time_s: float) -> FloatArray:
        """Pose on the track (3,), constant twist between knots, held at both ends (eq. 16)."""
        k = bisect.bisect_right(self.times_s, time_s)
        if k == 0 or k == len(self.times_s):
            at_end: FloatArray = self._odom_T_body[max(0, k - 1)].copy()
            return at_end
        t0, t1 = self.times_s[k - 1], self.times_s[k]
        pose: FloatArray = poses.interpolate(
            self._odom_T_body[k - 1], self._odom_T_body[k], (time_s - t0) / (t1 - t0)
        )
        return pose

    def is_broken(self, start_s: float, end_s: float) -> bool:
        """Whether the counters jump between two instants."""
        return any(before < end_s and after > start_s for before, after in self._breaks[-8:])

    def twist_over(self, start_s: float, end_s: float, config: OdometryConfig) -> FloatArray:
        """Mean body twist (3,) over an interval, widened where stamps are too coarse or lie."""
        if len(self.times_s) < 2:
            return np.zeros(3)
        window_s = max(MIN_TWIST_WINDOW_S, 2.0 * self.backwards_s)
        pad_s = max(0.0, 0.5 * (window_s - (end_s - start_s)))
        t0 = min(max(start_s - pad_s, self.times_s[0]), self.times_s[-1])
        t1 = max(min(end_s + pad_s, self.times_s[-1]), self.times_s[0])
        t0, t1 = self._beside_breaks(t0, t1)
        if t1 - t0 < 1e-3:
            return np.zeros(3)
        twist: FloatArray = poses.log(poses.between(self.pose_at(t0), self.pose_at(t1))) / (t1 - t0)
        if not is_plausible(twist, config):
            return np.zeros(3)
        return twist

    def _beside_breaks(self, t0: float, t1: float) -> tuple[float, float]:
        """The interval moved to one side of a jump within it."""
        length_s, middle_s = t1 - t0, 0.5 * (t0 + t1)
        for before, after in self._breaks[-8:]:
            if before < t1 and after > t0:
                if middle_s < after:
                    return max(before - length_s, self.times_s[0]), before
                return after, min(after + length_s, self.times_s[-1])
        return t0, t1


def is_plausible(twist: FloatArray | tuple[float, float, float], config: OdometryConfig) -> bool:
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


def factor_variances(step: FloatArray, distrusted: bool, config: OdometryConfig) -> FloatArray:
    """(3,) variances of a wheel factor; next to nothing is believed where the scans contradict the wheels."""
    share = config.white_share * (DISTRUSTED_SHARE if distrusted else 1.0)
    return step_sigmas(step, config) ** 2 / share


def step_sigmas(step: FloatArray, config: OdometryConfig) -> FloatArray:
    """One-sigma noise (3,) of a wheel motion ``step`` (3,) in its own frame: grows with the distance and
    the turn, sideways slip included."""
    x, y, theta = step.tolist()
    distance_m, turn_rad = math.hypot(x, y), abs(theta)
    along = config.sigma_floor_m + config.sigma_translation_per_m * distance_m
    across = config.sigma_floor_m + config.sigma_lateral_per_m * distance_m
    turn = (
        config.sigma_floor_rad
        + config.sigma_rotation_per_rad * turn_rad
        + config.sigma_rotation_per_m * distance_m
    )
    return np.array([along, across, turn])
