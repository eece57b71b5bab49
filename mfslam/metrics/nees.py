"""Whether stated covariances are true: the normalised estimation error squared."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import chdtri

from mfslam import se2
from mfslam.types import FloatArray, MfslamError

WITHIN = 0.95


@dataclass(frozen=True, slots=True)
class Nees:
    """``mean``: 1 for honest covariances, above it they promise too much. ``within``: share of the errors inside
    their 95 % ellipsoid. ``poses`` that were judged; the first one and those without a covariance are not."""

    mean: float
    within: float
    poses: int

    def as_json(self) -> dict[str, Any]:
        return {"mean_per_dof": self.mean, "within_95_percent": self.within, "poses": self.poses}


def nees(truth: FloatArray, estimate: FloatArray, covariances: FloatArray) -> Nees:
    """Of matched poses (N, 3) with covariances (N, 3, 3) of x, y, yaw in the estimate's axes, relative to
    the first pose.

    Raises MfslamError when no covariance can be inverted.
    """
    estimate_T_truth = se2.compose(estimate[0], se2.inverse(truth[0]))
    error = estimate - se2.compose(estimate_T_truth, truth)
    error[:, 2] = se2.wrap(error[:, 2])
    eigenvalues = np.linalg.eigvalsh(covariances)
    usable = eigenvalues[:, 0] > 1e-14 * np.maximum(eigenvalues[:, 2], 1e-12)
    usable[0] = False
    if not usable.any():
        raise MfslamError("no covariance is positive definite: there is nothing to hold errors against")
    e = error[usable]
    chi2 = np.einsum("na,na->n", e, np.linalg.solve(covariances[usable], e[:, :, None])[:, :, 0])
    return Nees(float(chi2.mean() / 3.0), float(np.mean(chi2 <= chdtri(3, 1.0 - WITHIN))), int(usable.sum()))
