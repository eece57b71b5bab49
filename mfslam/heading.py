"""What gyro and compass say of yaw: integrated turns with a running bias, absolute headings."""

from __future__ import annotations

import bisect
import math

import numpy as np

from mfslam import se2
from mfslam.config import ImuConfig
from mfslam.types import FloatArray, Imu

MAX_GAP_S = 0.2  # a gyro silent for longer has missed a turn
BIAS_MEMORY_S = 60.0


class HeadingTrack:
    """Yaw integrated from the gyro's rate, and the latest compass heading."""

    def __init__(self, config: ImuConfig) -> None:
        self.config = config
        self.bias_rad_s = 0.0
        self._bias_weight_s = 0.0
        self._times_s: list[float] = []
        self._yaw_rad: list[float] = []
        self._rate_rad_s = 0.0
        self._gaps: list[float] = []  # ends of gaps
        self._compass: list[tuple[float, float]] = []  # time, heading

    def add(self, time_s: float, imu: Imu, after_gap: bool = False) -> None:
        """Messages whose stamp does not advance are passed over. ``after_gap``: turns before it were missed."""
        if imu.yaw_rad is not None and self.config.use_compass:
            self._compass.append((time_s, imu.yaw_rad))
        if imu.yaw_rate_rad_s is None or not self.config.use_gyro:
            return
        rate_rad_s = (imu.yaw_rate_rad_s - self.config.gyro_bias_rad_s) / self.config.gyro_scale
        if not self._times_s:
            self._times_s.append(time_s)
            self._yaw_rad.append(0.0)
        else:
            dt_s = time_s - self._times_s[-1]
            if dt_s <= 0.0:
                return
            if after_gap or dt_s > MAX_GAP_S:
                self._gaps.append(time_s)
            self._times_s.append(time_s)
            self._yaw_rad.append(self._yaw_rad[-1] + 0.5 * dt_s * (self._rate_rad_s + rate_rad_s))
        self._rate_rad_s = rate_rad_s

    def turn(self, start_s: float, end_s: float) -> float | None:
        """Turn between two instants (rad), bias taken off; None where the gyro did not cover them."""
        times = self._times_s
        if len(times) < 2 or start_s < times[0] - MAX_GAP_S or end_s > times[-1] + MAX_GAP_S:
            return None
        first_gap = bisect.bisect_right(self._gaps, start_s)
        if first_gap < len(self._gaps) and self._gaps[first_gap] <= end_s + MAX_GAP_S:
            return None
        return self._yaw_at(end_s) - self._yaw_at(start_s) - self.bias_rad_s * (end_s - start_s)

    def turns(self) -> tuple[FloatArray, FloatArray]:
        """Times (G,) s and turns since the first of them (G,) rad, the bias learned meanwhile not taken off."""
        return np.array(self._times_s), np.array(self._yaw_rad)

    def turn_sigma(self, dt_s: float) -> float:
        """One sigma of a turn over ``dt_s``: rate noise and what is not known of the bias (rad)."""
        config = self.config
        return math.hypot(
            config.gyro_sigma_rad_per_sqrt_s * math.sqrt(max(dt_s, 1e-3)), config.bias_sigma_rad_s * dt_s
        )

    def learn_bias(self, dt_s: float, turn_rad: float, matched_turn_rad: float) -> None:
        """Let the bias follow the difference between the gyro's turn and the matched one."""
        if dt_s <= 0.0:
            return
        self._bias_weight_s = min(self._bias_weight_s + dt_s, BIAS_MEMORY_S)
        self.bias_rad_s += float(se2.wrap(turn_rad - matched_turn_rad)) / self._bias_weight_s

    def compass(self, time_s: float) -> tuple[float, float] | None:
        """Heading (rad) near an instant, zero at the first one, and its sigma; None without compass."""
        if not self._compass or abs(self._compass[-1][0] - time_s) > 1.0:
            return None
        k = min(range(len(self._compass)), key=lambda n: abs(self._compass[n][0] - time_s))
        heading = float(se2.wrap(self._compass[k][1] - self._compass[0][1]))
        return heading, math.radians(self.config.compass_sigma_deg)

    def _yaw_at(self, time_s: float) -> float:
        k = bisect.bisect_right(self._times_s, time_s)
        if k == 0:
            return self._yaw_rad[0]
        if k == len(self._times_s):
            return self._yaw_rad[-1]
        t0, t1 = self._times_s[k - 1], self._times_s[k]
        share = (time_s - t0) / (t1 - t0)
        return self._yaw_rad[k - 1] + share * (self._yaw_rad[k] - self._yaw_rad[k - 1])
