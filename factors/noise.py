"""Information matrices into gtsam noise models, without its traps."""

from __future__ import annotations

import math
from typing import Any

import gtsam

from mfslam.kernels import matrices
from mfslam.types import FloatArray

RELATIVE_FLOOR = 1e-9
ABSOLUTE_FLOOR = 1e-6  # 1000 m or 1000 rad of sigma: nothing at all


def noise_from_information(information: FloatArray) -> gtsam.noiseModel.Gaussian:
    """Gaussian noise model of a (3, 3) information matrix that may be singular.

    gtsam misreads a rotated singular information matrix (the unobservable direction becomes fully
    trusted), so a little is added to every eigenvalue before the root is taken: a weak direction stays
    weak, a strong one does not notice.
    Raises ValueError for a matrix that is not finite or clearly not positive semidefinite.
    """
    if information.shape != (3, 3):
        raise ValueError(f"expected a 3x3 information matrix, got shape {information.shape}")
    root = matrices.upper_root(information, ABSOLUTE_FLOOR, RELATIVE_FLOOR)
    if not math.isfinite(root[0, 0] + root[1, 1] + root[2, 2]):
        raise ValueError(f"information matrix is not finite or not positive semidefinite: {information!r}")
    return gtsam.noiseModel.Gaussian.SqrtInformation(root)


def robust_noise(noise: gtsam.noiseModel.Base, kernel: str, scale: float) -> gtsam.noiseModel.Robust:
    """``noise`` under a robust kernel: huber, cauchy, geman-mcclure, dcs or tls, scale in sigmas."""
    estimator = gtsam.noiseModel.mEstimator
    kernels: dict[str, Any] = {
        "huber": estimator.Huber,
        "cauchy": estimator.Cauchy,
        "geman-mcclure": estimator.GemanMcClure,
        "dcs": estimator.DCS,
        "tls": estimator.TruncatedLeastSquares,
    }
    parameter = scale**2 if kernel == "dcs" else scale  # that of dcs is a squared one
    return gtsam.noiseModel.Robust.Create(kernels[kernel].Create(parameter), noise)
