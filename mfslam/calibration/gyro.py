"""Scale and bias of a gyro, by the turns that the laser saw: told = scale x true + bias x time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mfslam import se2
from mfslam.calibration.record import Record
from mfslam.calibration.regression import regressed
from mfslam.types import FloatArray

JOINED = 8  # windows, so that the errors of the poses at their ends matter little
LEAST, MAX_GAP_S = 20, 0.2
LEAST_RAD = 1e-5  # spread of the turns' errors
# Of all turns of the laser, one sigma; see docs/calibration.md
SYSTEMATIC_TURN = 2e-4


@dataclass(frozen=True, eq=False)
class GyroFit:
    """``scale``, ``bias_rad_s`` beside those assumed, with their ``covariance`` (2, 2)."""

    scale: float
    bias_rad_s: float
    covariance: FloatArray


def fit_gyro(record: Record, delay_s: float) -> GyroFit | None:
    """None where there is no gyro, or next to nothing to compare it with."""
    times, yaw = record.gyro_times_s, record.gyro_yaw_rad
    windows = record.windows()
    first, last = (index[::JOINED] for index in windows.joined(JOINED))
    a, b = windows.a[first], windows.b[last]
    start_s, end_s = record.times_s[a] + delay_s, record.times_s[b] + delay_s
    if len(times) < 2:
        return None
    longest = np.concatenate([[0.0], np.diff(times)])
    silent = np.cumsum(longest > MAX_GAP_S)
    at = [np.clip(np.searchsorted(times, t), 0, len(times) - 1) for t in (start_s, end_s)]
    whole = (start_s > times[0]) & (end_s < times[-1]) & (silent[at[0]] == silent[at[1]])
    if np.count_nonzero(whole) < LEAST:
        return None
    a, b, start_s, end_s = a[whole], b[whole], start_s[whole], end_s[whole]
    told = np.interp(end_s, times, yaw) - np.interp(start_s, times, yaw)
    # joined windows turn farther than half a turn: the gyro knows how often
    seen = se2.between(record.world_T_laser[a], record.world_T_laser[b])[:, 2]
    seen = told + se2.wrap(seen - told)
    found, covariance = regressed(np.stack([seen, end_s - start_s], axis=1), told, LEAST_RAD)
    covariance = covariance * len(told) / (len(told) - 2)
    covariance[0, 0] += SYSTEMATIC_TURN**2
    return GyroFit(float(found[0]), float(found[1]), covariance)
