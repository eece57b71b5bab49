"""Information matrices into gtsam noise models, without its traps."""

from __future__ import annotations

from typing import Any

import math

import gtsam
import numpy as np

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
    symmetric = 0.5 * (information + information.T)
    top = float(symmetric.trace())
    if symmetric.shape != (3, 3) or not math.isfinite(top + float(symmetric.sum())):
        raise ValueError(f"expected a finite 3x3 information matrix, got {information!r}")
    try:
        lower = np.linalg.cholesky(symmetric + max(ABSOLUTE_FLOOR, RELATIVE_FLOOR * top) * np.eye(3))
    except np.linalg.LinAlgError:
        values = np.linalg.eigvalsh(symmetric)
        raise ValueError(f"information matrix is not positive semidefinite: eigenvalues {values}") from None
    return gtsam.noiseModel.Gaussian.SqrtInformation(np.ascontiguousarray(lower.T))


def robust_noise(noise: gtsam.noiseModel.Base, kernel: str, scale: float) -> gtsam.noiseModel.Robust:
    """``noise`` under a robust kernel: huber, cauchy or geman-mcclure, scale in sigmas."""
    estimator = gtsam.noiseModel.mEstimator
    kernels: dict[str, Any] = {
        "huber": estimator.Huber,
        "cauchy": estimator.Cauchy,
        "geman-mcclure": estimator.GemanMcClure,
    }
    return gtsam.noiseModel.Robust.Create(kernels[kernel].Create(scale), noise)
