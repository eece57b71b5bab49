"""Differential drive: wheel rates -> body twist -> motion -> dead-reckoned pose (eqs. 7-13).

Where the paper's equations slip, the exact ones are used. Eq. 11 takes the arctangent of the yaw rate
(kept as ``wheels.yaw_rate_rule: arctangent``). Eqs. 12, 13 and 40 move by \\|v\\| where v times the cycle
c_T is meant, take the heading at the end of the step for all of it, and lose the sign of v in reverse.
A step here is the exact arc, exp((v, 0, Omega) c_T), through all of which the wheels hold their rates.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from mfslam.config import WheelsConfig
from mfslam.kernels import poses
from mfslam.types import Findings, FloatArray, Odometry, WheelAngles, WheelTicks

TURN_RAD = 2.0 * math.pi
TICK_SPANS = (2.0**16, 2.0**32)  # of counters that wrap
ANGLE_SPANS = (TURN_RAD,)  # of angles that are told within one turn
MAX_WHEEL_SPEED_M_S = 15.0  # a faster wheel is a counter that jumped
MIN_STEP_S = 0.1  # stamps come in bursts: a shorter time between them proves nothing


def body_twist(left_rad_s: float, right_rad_s: float, wheels: WheelsConfig) -> FloatArray:
    """Body twist (3,) of two wheel rates: forward speed m/s, 0 (wheels do not slide), yaw rate rad/s.

    Paper: v_L = r_L omega_L, v_R = r_R omega_R (eqs. 8, 9), v = (v_R + v_L) / 2 (eq. 10) and
    Omega = (v_R - v_L) / L, or eq. 11's arctangent of that in 1/s.
    """
    left_m_s = wheels.radius_left_m * left_rad_s  # eq. 8
    right_m_s = wheels.radius_right_m * right_rad_s  # eq. 9
    yaw_rate_rad_s = (right_m_s - left_m_s) / wheels.track_m
    if wheels.yaw_rate_rule == "arctangent":
        yaw_rate_rad_s = math.atan(yaw_rate_rad_s)  # eq. 11 as printed
    return np.array([0.5 * (right_m_s + left_m_s), 0.0, yaw_rate_rad_s])  # eq. 10


def move(world_T_body: FloatArray, twist: FloatArray, duration_s: float) -> FloatArray:
    """Pose (3,) after ``twist`` (3,) was held for ``duration_s``: eq. 12 made exact."""
    moved: FloatArray = poses.advance(world_T_body, twist, duration_s)
    return moved


class WheelIntegrator:
    """Encoder counters or wheel angles into a dead-reckoned pose (eq. 7), which starts at the origin.

    Counters that wrap (16 or 32 bit; angles at one turn) are followed. A step that no wheel can make, as
    when a counter starts again from zero, is left out: the pose stays, the next step counts from there.
    Smaller jumps are integrated: only their caller knows what the robot can do.

    findings: where wraps and jumps are counted.
    """

    def __init__(self, wheels: WheelsConfig, findings: Findings | None = None) -> None:
        self.odom_T_body: FloatArray = np.zeros(3)
        self.findings = Findings() if findings is None else findings
        self._wheels = wheels
        self._signs = (-1.0 if wheels.left_reversed else 1.0, -1.0 if wheels.right_reversed else 1.0)
        self._ticks = (_Counter(TICK_SPANS), _Counter(TICK_SPANS))
        self._angles = (_Counter(ANGLE_SPANS), _Counter(ANGLE_SPANS))
        self._last_ns: int | None = None

    def add_ticks(self, ticks: WheelTicks) -> Odometry:
        """Pose once the wheels stand at these counters."""
        rad_per_tick = TURN_RAD / self._wheels.ticks_per_turn
        return self._add(ticks.stamp_ns, self._ticks, (float(ticks.left), float(ticks.right)), rad_per_tick)

    def add_angles(self, angles: WheelAngles) -> Odometry:
        """Pose once the wheels stand at these angles. Angles that are not finite are left out."""
        values = (angles.left_rad, angles.right_rad)
        if not all(map(math.isfinite, values)):
            self._tell("wheel-angle-invalid", "wheel angle is not a number: left out", angles.stamp_ns)
            return Odometry(angles.stamp_ns, self.odom_T_body)
        return self._add(angles.stamp_ns, self._angles, values, 1.0)

    def _add(
        self,
        stamp_ns: int,
        counters: tuple[_Counter, _Counter],
        values: tuple[float, float],
        rad_per_unit: float,
    ) -> Odometry:
        steps = [counter.step(value) for counter, value in zip(counters, values, strict=True)]
        left_rad, right_rad = (
            sign * step * rad_per_unit for sign, (step, _) in zip(self._signs, steps, strict=True)
        )
        elapsed_s = 0.0 if self._last_ns is None else (stamp_ns - self._last_ns) * 1e-9
        self._last_ns = stamp_ns
        farthest_m = max(
            abs(left_rad) * self._wheels.radius_left_m, abs(right_rad) * self._wheels.radius_right_m
        )
        if farthest_m > MAX_WHEEL_SPEED_M_S * max(elapsed_s, MIN_STEP_S):
            self._tell(
                "wheel-counter-jump", "wheel counter jumped or started again: the step is left out", stamp_ns
            )
            return Odometry(stamp_ns, self.odom_T_body)
        for counter, (step, _) in zip(counters, steps, strict=True):
            counter.last_step = step
        if any(wrapped for _, wrapped in steps):
            self._tell("wheel-counter-wrapped", "wheel counter wrapped: followed", stamp_ns)
        # held rates over the time between stamps; where that is no time, over a unit of it
        duration_s = elapsed_s if elapsed_s > 0.0 else 1.0
        twist = body_twist(left_rad / duration_s, right_rad / duration_s, self._wheels)
        self.odom_T_body = move(self.odom_T_body, twist, duration_s)
        return Odometry(stamp_ns, self.odom_T_body)

    def _tell(self, code: str, text: str, stamp_ns: int) -> None:
        self.findings.add(code, text, f"{stamp_ns} ns")


@dataclass(slots=True)
class _Counter:
    """One wheel's counter: steps between its values, followed through wraps.

    It wraps at a span only while all its values have kept within that span (from 0, or about 0). Of the
    steps that are then possible, the one nearest to the step before is taken.
    """

    spans: tuple[float, ...]
    last_step: float = 0.0
    _value: float | None = field(default=None)
    _low: float = math.inf
    _high: float = -math.inf

    def step(self, value: float) -> tuple[float, bool]:
        """Step since the value before (0 for the first), and whether it went through a wrap."""
        self._low, self._high = min(self._low, value), max(self._high, value)
        before, self._value = self._value, value
        if before is None:
            return 0.0, False
        raw = value - before
        possible = [raw]
        for span in self.spans:
            if (self._low >= 0.0 and self._high <= span) or (
                self._low >= -0.5 * span and self._high <= 0.5 * span
            ):
                possible += [raw - span, raw + span]
        chosen = min(possible, key=lambda step: abs(step - self.last_step))
        return chosen, chosen != raw
