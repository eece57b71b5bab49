"""Heading factors: what a gyro or a compass says of yaw alone.

Gyro residual: theta_j - theta_i - integral of the yaw rate, one sigma from rate noise and bias drift.
Compass residual: theta_i - heading measured. Both leave x and y open.
"""

from __future__ import annotations

import gtsam
import numpy as np


def gyro_factor(i: int, j: int, turn_rad: float, sigma_rad: float) -> gtsam.BetweenFactorPose2:
    """Turn from pose i to pose j; translation is left open: no information at all, not little."""
    noise = gtsam.noiseModel.Diagonal.Precisions(np.array([0.0, 0.0, sigma_rad**-2]))
    return gtsam.BetweenFactorPose2(i, j, gtsam.Pose2(0.0, 0.0, turn_rad), noise)


def compass_factor(i: int, heading_rad: float, sigma_rad: float) -> gtsam.PoseRotationPrior2D:
    """Absolute heading of pose i."""
    return gtsam.PoseRotationPrior2D(
        i, gtsam.Rot2(heading_rad), gtsam.noiseModel.Isotropic.Sigma(1, sigma_rad)
    )
