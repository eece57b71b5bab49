"""Batch solves that decide which loops to believe: graduated non-convexity (Yang et al. 2020), truncated
least squares."""

from __future__ import annotations

import numpy as np

from mfslam.graph.least_squares import PoseSolver
from mfslam.types import BoolArray, FloatArray

PACE = 1.4  # of mu, the usual schedule: faster ones believe false loops where true ones are few
MAX_ROUNDS, STEPS = 100, 1  # the weights move slowly: one step follows them
SAME_COST, BINARY = 1e-5, 1e-4
LEAST_MU = 1e-6


def graduated_solve(
    solver: PoseSolver, poses: FloatArray, weights: FloatArray, doubtful: BoolArray, limit: float
) -> FloatArray:
    """Poses (K, 3) without the outliers among the ``doubtful`` edges (E,), those whose chi2 stays above ``limit``; edges of
    weight 0 in ``weights`` (E,) have no say."""
    nobody = np.zeros(len(weights), np.bool_)
    doubtful = doubtful & (weights > 0.0)
    excess = 2.0 * solver.chi2(poses)[doubtful] - limit
    solved = solver.solve(poses, weights, nobody, 1.0)
    if not np.any(excess > 0.0):
        return solved
    mu = max(LEAST_MU, limit / float(excess.max()))
    chi2 = solver.chi2(solved)
    cost = float(weights @ chi2)
    for _ in range(MAX_ROUNDS):
        weights = weights.copy()
        weights[doubtful] = _truncated(chi2[doubtful], mu, limit)
        solved = solver.solve(solved, weights, nobody, 1.0, STEPS)
        chi2 = solver.chi2(solved)
        cost_before, cost = cost, float(weights @ chi2)
        undecided = np.minimum(weights[doubtful], 1.0 - weights[doubtful])
        if abs(cost_before - cost) <= SAME_COST * max(cost_before, 1e-7) or undecided.max() < BINARY:
            break
        mu *= PACE
    return solver.solve(solved, weights, nobody, 1.0)


def _truncated(chi2: FloatArray, mu: float, limit: float) -> FloatArray:
    """Weights of the surrogate of truncated least squares (eq. 14)."""
    between = np.sqrt(limit * mu * (mu + 1.0) / np.maximum(chi2, 1e-300)) - mu
    return np.where(
        chi2 >= (mu + 1.0) / mu * limit, 0.0, np.where(chi2 <= mu / (mu + 1.0) * limit, 1.0, between)
    )
