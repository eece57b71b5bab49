"""Robust Gauss-Newton for wheels, mount, delay and drift from windows of motion, with honest covariance."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded

from mfslam import se2
from mfslam.calibration.noise import FIRST_GUESS, Noise, banded, found_noise, robust_weights
from mfslam.calibration.problem import Problem
from mfslam.calibration.record import Windows
from mfslam.types import FloatArray

ITERATIONS = 12
BLOCK = 16  # successive windows whose errors may hang together in ways that the noise does not model
# What the laser's own motions on the adjusted trajectory are off by all along, one sigma, of ways, of turns, in time (s)
# and as if it stood elsewhere (m): no scatter within a log shows it. By exact truth in simulation, see docs/calibration.md.
SYSTEMATIC_WAY, SYSTEMATIC_TURN, SYSTEMATIC_S, SYSTEMATIC_M = 1e-4, 1e-4, 1e-4, 1.5e-4


@dataclass(frozen=True, eq=False)
class Solved:
    """``values`` (P,) of ``names``, as differences from what was assumed but for wheels; ``covariance`` (P, P);
    ``weights`` (N,): of the windows; ``noise``."""

    names: tuple[str, ...]
    values: FloatArray
    covariance: FloatArray
    weights: FloatArray
    windows: Windows
    noise: Noise

    def of(self, count: int) -> Solved:
        """The first ``count`` parameters alone, whatever the others are."""
        return replace(
            self,
            names=self.names[:count],
            values=self.values[:count],
            covariance=self.covariance[:count, :count],
        )


def solve(problem: Problem, start: FloatArray | None = None) -> Solved:
    values = (problem.start if start is None else start).copy()
    n = len(problem.windows)
    noise = FIRST_GUESS
    prior = np.diag(problem.prior_sigmas**-2.0)
    for iteration in range(ITERATIONS):
        error, jacobian = problem.linearised(values, noise.ends)
        weights = robust_weights(problem.windows, error, noise)
        band = cholesky_banded(banded(problem.windows, noise, weights), lower=True)
        flat = jacobian.reshape(3 * n, -1)
        white = cho_solve_banded((band, True), np.column_stack([flat, error.ravel()]))
        covariance = np.linalg.inv(flat.T @ white[:, :-1] + prior)
        step = -covariance @ (flat.T @ white[:, -1] + prior @ (values - problem.start))
        values = values + step
        noise = found_noise(problem, values, noise)
        if iteration > 2 and np.all(np.abs(step) < 0.02 * np.sqrt(np.diag(covariance))):
            break
    scores = np.einsum("nrp,nr->np", jacobian, white[:, -1].reshape(n, 3))
    honest = as_scattered(covariance, scores, prior) + systematic(
        problem, covariance, white[:, :-1], jacobian
    )
    return Solved(problem.names, values, honest, weights, problem.windows, noise)


def as_scattered(covariance: FloatArray, scores: FloatArray, prior: FloatArray) -> FloatArray:
    """The covariance (P, P) by how the scores (N, P) of the windows scatter, neighbours together (a sandwich with
    Bartlett's kernel), and as the information of the ``prior`` (P, P) says where there is little else."""
    n, count = scores.shape
    block = max(1, min(BLOCK, n // (4 * count)))
    so_far = np.cumsum(np.vstack([np.zeros((block, count)), scores, np.zeros((block - 1, count))]), axis=0)
    sums = so_far[block:] - so_far[:-block] if block > 1 else scores
    meat = sums.T @ sums / block * (n / (n - block * count))
    return np.asarray(covariance @ (meat + prior) @ covariance)


def systematic(
    problem: Problem, covariance: FloatArray, white: FloatArray, jacobian: FloatArray
) -> FloatArray:
    """(P, P) what systematic errors of the laser's motions do to the solution."""
    motion = se2.log(problem.windows.a_T_b)
    way, turn = motion * [SYSTEMATIC_WAY, SYSTEMATIC_WAY, 0.0], motion * [0.0, 0.0, SYSTEMATIC_TURN]
    patterns = [way, turn, *(SYSTEMATIC_M * jacobian[:, :, problem.n_wheel + axis] for axis in range(2))]
    if problem.clock:
        patterns.append(SYSTEMATIC_S * jacobian[:, :, -2])
    moved = covariance @ (white.T @ np.stack([p.ravel() for p in patterns], axis=1))
    return np.asarray(moved @ moved.T)
