"""Information matrices into gtsam noise models, without its traps."""

from __future__ import annotations

from typing import Any

import gtsam
import numpy as np

from mfslam.types import FloatArray

RELATIVE_FLOOR = 1e-9
ABSOLUTE_FLOOR = 1e-6  # 1000 m or 1000 rad of sigma: nothing at all


def square_roots(informations: FloatArray) -> FloatArray:
    """(N, 3, 3) upper triangular R with R^T R = H, of information matrices (N, 3, 3) that may be singular.

    gtsam misreads a rotated singular information matrix (the unobservable direction becomes fully
    trusted), so the eigenvalues are floored first: a weak direction stays weak.
    Raises ValueError for a matrix that is not finite or clearly not positive semidefinite.
    """
    if informations.ndim != 3 or informations.shape[1:] != (3, 3) or not np.all(np.isfinite(informations)):
        raise ValueError(f"expected finite information matrices (N, 3, 3), got {informations!r}")
    values, vectors = np.linalg.eigh(0.5 * (informations + informations.transpose(0, 2, 1)))
    top = np.maximum(values[:, -1:], ABSOLUTE_FLOOR)
    bad = np.flatnonzero(values[:, 0] < -1e-6 * top[:, 0])
    if bad.size:
        raise ValueError(f"information matrix is not positive semidefinite: eigenvalues {values[bad[0]]}")
    floored = np.maximum(values, np.maximum(ABSOLUTE_FLOOR, RELATIVE_FLOOR * top))
    upper = np.linalg.qr((vectors * np.sqrt(floored)[:, None, :]).transpose(0, 2, 1), mode="r")
    # rows may be negated at will; gtsam wants sigmas, hence a diagonal, that are positive
    signs = np.where(np.diagonal(upper, axis1=1, axis2=2) < 0.0, -1.0, 1.0)
    return np.asarray(upper * signs[:, :, None])


def noise_from_information(information: FloatArray) -> gtsam.noiseModel.Gaussian:
    """Gaussian noise model of one (3, 3) information matrix; see `square_roots`."""
    return gtsam.noiseModel.Gaussian.SqrtInformation(square_roots(np.asarray(information)[None])[0])


def robust_noise(noise: gtsam.noiseModel.Base, kernel: str, scale: float) -> gtsam.noiseModel.Robust:
    """``noise`` under a robust kernel: huber, cauchy or geman-mcclure, scale in sigmas."""
    estimator = gtsam.noiseModel.mEstimator
    kernels: dict[str, Any] = {
        "huber": estimator.Huber,
        "cauchy": estimator.Cauchy,
        "geman-mcclure": estimator.GemanMcClure,
    }
    return gtsam.noiseModel.Robust.Create(kernels[kernel].Create(scale), noise)
