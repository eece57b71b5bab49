"""Least squares of keyframe poses: Gauss-Newton on the factor of a sparse matrix of blocks, damped where a step fails.

The optimum is that of gtsam's Levenberg-Marquardt on the same edges, at about a microsecond a pose and iteration.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mfslam.graph.edges import EdgeArrays
from mfslam.kernels import block_cholesky, graph_terms
from mfslam.sparse_blocks import Pattern
from mfslam.types import BoolArray, FloatArray, IntArray

MAX_ITERATIONS = 30
SETTLED = 1e-7  # relative decrease of the cost at which a solve has arrived
STILL = 1e-9  # m or rad: a step that moves nothing
LEAST_DAMPING, MOST_DAMPING = 1e-6, 1e10  # information on every pose: 1 km and 1000 rad; nothing moves


class Factor:
    """Information of all poses but the first, which is the origin, factorised where they stand."""

    def __init__(self, pattern: Pattern, place: IntArray) -> None:
        self.pattern, self.place = pattern, place
        count = len(pattern.place)
        self.diagonal, self.rhs = np.empty((count, 3, 3)), np.empty((count, 3))
        self.below = np.empty((len(pattern.rows), 3, 3))


class PoseSolver:
    """Solves for the poses (K, 3) that given edges tie together, the first ``held`` of which stay where they are; the
    pattern is found once for all iterations."""

    def __init__(self, edges: EdgeArrays, count: int, held: int = 1) -> None:
        self.edges = edges
        ends = edges.ends
        inner = (ends[:, 0] != ends[:, 1]) & (ends >= held).all(axis=1)
        pattern = Pattern.of(ends[inner, 0] - held, ends[inner, 1] - held, count - held)
        place = np.concatenate([np.full(held, -1), pattern.place])
        self._slots = np.zeros(len(edges), np.int64)
        self._slots[inner] = pattern.slots
        self.factor = Factor(pattern, place)

    def solve(
        self, poses: FloatArray, weights: FloatArray, robust: BoolArray, kernel_sigmas: float,
        max_iterations: int = MAX_ITERATIONS, relative_gain: float = SETTLED,
    ) -> FloatArray:  # fmt: skip
        """Poses from where they stand. ``weights`` (E,) of the edges; those that are ``robust`` (E,) have a Cauchy kernel.

        Leaves `factor` as of the last iteration. Raises FloatingPointError where no step leads anywhere finite.
        """
        kernel = _Kernel(np.flatnonzero(robust), kernel_sigmas**2)
        chi2 = self.chi2(poses)
        cost = kernel.cost(chi2, weights)
        damping = LEAST_DAMPING
        for _ in range(max_iterations):
            step = self._step(poses, kernel.weights(chi2, weights), damping)
            moved = graph_terms.moved_poses(poses, self.factor.place, step)
            chi2_there = self.chi2(moved)
            cost_there = kernel.cost(chi2_there, weights)
            if not cost_there <= cost * (1.0 + 1e-12):  # not a number, too
                if np.abs(step).max() < STILL:
                    break
                damping = max(damping * 100.0, 1e-3 * float(np.median(self.information_scale)))
                if damping > MOST_DAMPING or not math.isfinite(damping):
                    raise FloatingPointError("no step makes the pose graph's error smaller")
                continue
            gain, poses, chi2, cost = cost - cost_there, moved, chi2_there, cost_there
            damping = max(LEAST_DAMPING, 0.01 * damping)
            if gain <= relative_gain * cost or np.abs(step).max() < STILL:
                break
        return poses

    def chi2(self, poses: FloatArray) -> FloatArray:
        """(E,) of the edges at ``poses`` (K, 3)."""
        e = self.edges
        return np.asarray(graph_terms.edge_chi2(e.ends, e.measured, e.information, poses))

    def _step(self, poses: FloatArray, weights: FloatArray, damping: float) -> FloatArray:
        e, f = self.edges, self.factor
        graph_terms.normal_equations(
            e.ends, e.measured, e.information, weights, poses, f.place, self._slots, damping,
            f.diagonal, f.below, f.rhs,
        )  # fmt: skip
        self.information_scale = f.diagonal[:, 0, 0].copy()
        block_cholesky.factorise(f.pattern.first, f.pattern.rows, f.diagonal, f.below)
        step = f.rhs.copy()
        block_cholesky.substitute(f.pattern.first, f.pattern.rows, f.diagonal, f.below, step)
        return step


@dataclass(frozen=True, eq=False)
class _Kernel:
    """Cauchy kernels of one ``squared`` scale on the edges ``robust`` (R,)."""

    robust: IntArray
    squared: float

    def weights(self, chi2: FloatArray, weights: FloatArray) -> FloatArray:
        """(E,) what the kernels leave of the edges' weights."""
        out = weights.copy()
        out[self.robust] /= 1.0 + chi2[self.robust] / self.squared
        return out

    def cost(self, chi2: FloatArray, weights: FloatArray) -> float:
        """Sum of chi2 (E,) under the kernels."""
        own = chi2.copy()
        own[self.robust] = self.squared * np.log1p(chi2[self.robust] / self.squared)
        return float(weights @ own)
