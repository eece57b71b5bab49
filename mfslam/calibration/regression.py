"""Least squares with outliers capped."""

from __future__ import annotations

import numpy as np

from mfslam.types import FloatArray

CAP_SIGMAS, ROUNDS = 3.0, 5


def regressed(rows: FloatArray, told: FloatArray, least_spread: float) -> tuple[FloatArray, FloatArray]:
    """(P,) of told (N,) = rows (N, P) x + error, errors beyond some times their spread weighing less (Huber); and the
    covariance (P, P) that their scatter shows. ``least_spread``: of the errors, below which none is taken to be beyond."""
    weights = np.ones(len(told))
    for _ in range(ROUNDS):
        bread = np.linalg.inv(rows.T @ (weights[:, None] * rows))
        found = bread @ (rows.T @ (weights * told))
        off = told - rows @ found
        cap = CAP_SIGMAS * max(1.5 * float(np.median(np.abs(off))), least_spread)
        weights = np.minimum(1.0, cap / np.maximum(np.abs(off), 1e-12))
    scores = rows * (weights * off)[:, None]
    return found, np.asarray(bread @ (scores.T @ scores) @ bread)
