"""Poses from which false loops can be told from true ones, found in two ways that fail differently.

`grown` builds the graph up along the path, as a robot does, and decides the loops of each stretch when the
poses before it stand: a false loop meets little drift and much evidence. It fails where the first loops close a
long lap, for then nothing stands yet.

`drift_annealed` takes all loops at once, each only as firmly as dead reckoning between its ends allows: its
covariance begins with that of the chain added to its own, and the chain's share falls to nothing. It fails where
false loops fold the graph at once.
"""

from __future__ import annotations

import numpy as np

from mfslam import se2
from mfslam.graph.gauss_newton import step
from mfslam.pose_graphs.data import Problem
from mfslam.types import BoolArray, FloatArray

_FIRST_STRETCH = 30  # poses
_GROWTH = 1.15  # of the graph, stretch by stretch: cost stays a multiple of one solve of it all
_PACE = 2.0  # by which the limit, or the share of the drift, falls each step
_LEAST_DRIFT = 1e-4  # of the chain's covariance: none to speak of
_NO_LOOP = 1e-2  # of weight


def loop_weights(problem: Problem, world_T_pose: FloatArray, limit: float) -> FloatArray:
    """(E,) Tukey's weights (1 - chi2 / limit)^2 of loops, nothing above the limit; the chain has 1."""
    weights = np.clip(1.0 - problem.chi2(world_T_pose) / limit, 0.0, 1.0) ** 2
    weights[weights < _NO_LOOP] = 0.0
    return np.where(problem.chain(), 1.0, weights)


def annealed(problem: Problem, world_T_pose: FloatArray, top: float, bottom: float) -> FloatArray:
    """Poses (N, 3) when the limit has fallen from ``top`` to ``bottom``, one step each time."""
    limit, poses = top, world_T_pose
    while True:
        poses = step(problem, poses, loop_weights(problem, poses, limit))
        if limit <= bottom:
            return poses
        limit = max(limit / _PACE, bottom)


def grown(problem: Problem, reckoned: FloatArray, top: float, bottom: float) -> FloatArray:
    """Poses (N, 3) of the graph built up along dead reckoning (N, 3), stretch by stretch."""
    poses, known, size = reckoned.copy(), 1, min(_FIRST_STRETCH, problem.size)
    while True:
        poses[known:size] = se2.compose(
            poses[known - 1], se2.between(reckoned[known - 1], reckoned[known:size])
        )
        poses[:size] = annealed(_beginning(problem, size), poses[:size], top, bottom)
        if size == problem.size:
            return poses
        known, size = size, min(int(np.ceil(size * _GROWTH)), problem.size)


def _beginning(problem: Problem, size: int) -> Problem:
    """The graph of the first poses alone."""
    prior = problem.i == problem.size
    inside = (prior | (problem.i < size)) & (problem.j < size)
    return Problem(
        problem.world_T_pose[:size],
        np.where(prior, size, problem.i)[inside],
        problem.j[inside],
        problem.i_T_j[inside],
        problem.information[inside],
        problem.held[:size],
    )


def drift_annealed(problem: Problem, reckoned: FloatArray, limit: float) -> FloatArray:
    """Poses (N, 3) when loops have become as firm as they say, from dead reckoning (N, 3) on.

    ``limit``: of a true loop's chi2 under the covariance of loop and drift together.
    """
    trusted, poses, share = problem.chain(), reckoned, 1.0
    while share > _LEAST_DRIFT:
        error = problem.residuals(poses)
        chi2 = problem.chi2(poses)
        # with D the drift: inverse(inverse(I) + D) = I inverse(1 + D I), also where I is singular
        softer = np.eye(3) + share * drift(problem, poses) @ problem.information
        eased = np.linalg.solve(softer, error[..., None])
        chi2_eased = np.einsum("ea,eab,ebc->e", error, problem.information, eased)
        firmness = np.where(chi2 > 0, chi2_eased / np.where(chi2 > 0, chi2, 1.0), 1.0)
        weights = np.clip(1.0 - chi2_eased / limit, 0.0, 1.0) ** 2 * firmness
        poses = step(problem, poses, np.where(trusted, 1.0, weights))
        share /= _PACE
    return poses


def drift(problem: Problem, world_T_pose: FloatArray) -> FloatArray:
    """(E, 3, 3) covariance of the chain of odometry between the ends of every edge, in the frame of pose j.

    In one frame for all, the covariance of a stretch is the difference of two running sums.
    """
    chain = steps_of_chain(problem)
    end = np.maximum(problem.i[chain], problem.j[chain])
    poses = se2.between(world_T_pose[0], world_T_pose)
    running = np.zeros((problem.size, 3, 3))
    information = problem.information[chain]
    least = 1e-9 * np.trace(information, axis1=1, axis2=2)  # a direction that a step knows nothing of
    running[end] = _carried(
        se2.adjoint(poses[end]), np.linalg.inv(information + least[:, None, None] * np.eye(3))
    )
    running = np.cumsum(running, axis=0)
    i = np.where(problem.i == problem.size, 0, problem.i)
    between = running[np.maximum(i, problem.j)] - running[np.minimum(i, problem.j)]
    return _carried(se2.adjoint(se2.inverse(poses[problem.j])), between)


def steps_of_chain(problem: Problem) -> BoolArray:
    """(E,): edges from a pose to the next one in the file; no priors."""
    return np.asarray((np.abs(problem.j - problem.i) == 1) & (problem.i < problem.size))


def _carried(adjoint: FloatArray, covariance: FloatArray) -> FloatArray:
    return np.asarray(adjoint @ covariance @ adjoint.swapaxes(-1, -2))
