"""Information matrices into gtsam noise models, without its traps."""

from __future__ import annotations

from typing import Any

import gtsam
import numpy as np

from mfslam.types import FloatArray

RELATIVE_FLOOR = 1e-9
ABSOLUTE_FLOOR = 1e-6  # 1000 m or 1000 rad of sigma: nothing at all


def noise_from_information(information: FloatArray) -> gtsam.noiseModel.Gaussian:
    """Gaussian noise model of a (3, 3) information matrix that may be singular.

    gtsam misreads a rotated singular information matrix (the unobservable direction becomes fully
    trusted), so the eigenvalues are floored first: a weak direction stays weak.
    Raises ValueError for a matrix that is not finite or clearly not positive semidefinite.
    """
    symmetric = 0.5 * (information + information.T)
    if symmetric.shape != (3, 3) or not np.all(np.isfinite(symmetric)):
        raise ValueError(f"expected a finite 3x3 information matrix, got {information!r}")
    values, vectors = np.linalg.eigh(symmetric)
    top = max(float(values[-1]), ABSOLUTE_FLOOR)
    if values[0] < -1e-6 * top:
        raise ValueError(f"information matrix is not positive semidefinite: eigenvalues {values}")
    floored = np.maximum(values, max(ABSOLUTE_FLOOR, RELATIVE_FLOOR * top))
    upper: FloatArray = np.asarray(np.linalg.qr((vectors * np.sqrt(floored)).T, mode="r"))
    # rows may be negated at will; gtsam wants sigmas, hence a diagonal, that are positive
    upper *= np.where(np.diag(upper) < 0.0, -1.0, 1.0)[:, None]
    return gtsam.noiseModel.Gaussian.SqrtInformation(upper)


def robust_noise(noise: gtsam.noiseModel.Base, kernel: str, scale: float) -> gtsam.noiseModel.Robust:
    """``noise`` under a robust kernel: huber, cauchy or geman-mcclure, scale in sigmas."""
    estimator = gtsam.noiseModel.mEstimator
    kernels: dict[str, Any] = {
        "huber": estimator.Huber,
        "cauchy": estimator.Cauchy,
        "geman-mcclure": estimator.GemanMcClure,
    }
    return gtsam.noiseModel.Robust.Create(kernels[kernel].Create(scale), noise)
