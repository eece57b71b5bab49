"""Scan-match factor between two poses.

Residual: log(i_T_j_measured^-1 * (world_T_i^-1 * world_T_j)), whitened by the square root of the
information of the match. Directions that the scans leave open carry next to no information.
"""

from __future__ import annotations

import gtsam

from factors.noise import noise_from_information
from mfslam.types import FloatArray


def scan_match_factor(i: int, j: int, i_T_j: FloatArray, information: FloatArray) -> gtsam.BetweenFactorPose2:
    """Between factor from a `Match` (pose (3,), information (3, 3))."""
    return gtsam.BetweenFactorPose2(i, j, gtsam.Pose2(*i_T_j), noise_from_information(information))
