"""Prior on a pose: residual log(world_T_i_prior^-1 * world_T_i). The first pose is held by one."""

from __future__ import annotations

import gtsam
import numpy as np

from mfslam.types import FloatArray


def prior_factor(i: int, world_T_i: FloatArray, sigmas: FloatArray) -> gtsam.PriorFactorPose2:
    """``sigmas`` (3,): metres, metres, radians."""
    noise = gtsam.noiseModel.Diagonal.Sigmas(np.asarray(sigmas, dtype=np.float64))
    return gtsam.PriorFactorPose2(i, gtsam.Pose2(*world_T_i), noise)
