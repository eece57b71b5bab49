"""Poses of wheels that came with the scans: their heading may have been read at another instant than their position."""

from __future__ import annotations

import numpy as np

from mfslam import se2
from mfslam.calibration.regression import regressed
from mfslam.types import BoolArray, FloatArray

LEAST_DT_S, LEAST_SPREAD_M = 0.02, 1e-4
LEAST_STEPS, LEAST_POWER_M2 = 50, 1e-6
MOST_S = 0.5


def heading_ahead_s(poses: FloatArray, times_s: FloatArray, usable: BoolArray) -> float:
    """By how much the heading of poses (S, 3) is newer than their position.

    Wheels never move sideways. With a heading that is newer by tau, a step seen along it does: by -tau v theta, and by
    o theta where what is told is a point o ahead of the axle. ``usable`` (S - 1,): steps that are no jumps.
    """
    step, dt_s = se2.log(se2.between(poses[:-1], poses[1:])), np.diff(times_s)
    step, dt_s = step[usable & (dt_s > LEAST_DT_S)], dt_s[usable & (dt_s > LEAST_DT_S)]
    turn_at_speed = step[:, 0] * step[:, 2] / dt_s
    if len(step) < LEAST_STEPS or np.sum(turn_at_speed**2) < LEAST_POWER_M2 or np.ptp(step[:, 2]) == 0.0:
        return 0.0
    (_, slope_s), _ = regressed(np.stack([step[:, 2], turn_at_speed], axis=1), step[:, 1], LEAST_SPREAD_M)
    return float(np.clip(-slope_s, -MOST_S, MOST_S))


def paired(poses: FloatArray, times_s: FloatArray, usable: BoolArray) -> FloatArray:
    """The poses (S, 3) with the heading of the instant of their position."""
    ahead_s = heading_ahead_s(poses, times_s, usable)
    heading = np.interp(times_s - ahead_s, times_s, np.unwrap(poses[:, 2]))
    return np.column_stack([poses[:, :2], heading])
