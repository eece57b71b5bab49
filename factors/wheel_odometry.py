"""Wheel-odometry factor between two poses, with a slip-aware covariance.

Residual: log(i_T_j_wheels^-1 * (world_T_i^-1 * world_T_j)). Its sigmas grow with the distance driven and
the turn made; a step in which the wheels were seen to jump or slip keeps almost no weight.
"""

from __future__ import annotations

import gtsam

from factors.noise import noise_from_information
from mfslam.types import FloatArray


def wheel_odometry_factor(
    i: int, j: int, i_T_j: FloatArray, information: FloatArray
) -> gtsam.BetweenFactorPose2:
    """Between factor from wheel motion (pose (3,), information (3, 3) of `mfslam.odometry.factor_information`)."""
    return gtsam.BetweenFactorPose2(i, j, gtsam.Pose2(*i_T_j), noise_from_information(information))
