"""A pose graph with false loops, solved by graduated non-convexity.

Every loop outside the odometry chain has Tukey's weight (1 - chi2 / L)^2, none above L. L falls from far above
to what chi2 of a true loop allows, one step of least squares each time, so loops are refused only when those that
agree have pulled the graph together. Three things make it hold where plain schedules fail:

- it begins at dead reckoning, not at a least-squares solve that false loops have folded already;
- it is heated again: what was refused beside a false loop may come back once that one is gone;
- noise that is smaller than the file says is seen in the loops that agree, and L then falls further:
  under noise models forty times too wide a chain bends to a false loop at no cost.

Several heats are tried, and the one with the lowest truncated cost is kept.
"""

from __future__ import annotations

import time

import numpy as np
from scipy.stats import chi2 as chi2_distribution

from mfslam import se2
from mfslam.graph.batch import Solution, solve
from mfslam.pose_graphs.data import Problem
from mfslam.types import FloatArray

LIMIT = float(chi2_distribution.ppf(0.99, 3))  # chi2 of a true loop
_MEDIAN = float(chi2_distribution.median(3))
_HEATS = (10.0, 100.0)  # times LIMIT
_KERNEL = ("geman-mcclure", 2.3849)
_KERNEL_STEPS = 20
_ROUNDS = 3
_PACE = 2.0
_SPARE = 10.0  # noise of real loops has wider tails than its median tells
_NO_LOOP = 1e-2  # of weight


def solve_robust(problem: Problem, start: FloatArray) -> Solution:
    """Poses, and weights 1 (believed) or 0 (refused) of all edges; chi2 steps are of the believed ones.

    ``start`` (N, 3) is used where the chain of odometry is broken. Raises MfslamError when the edges leave
    a pose open.
    """
    began = time.process_time()
    if problem.chain().all():
        return solve(problem, start)
    reckoned = dead_reckoning(problem)
    begin = start if reckoned is None else reckoned
    tried = [_heated(problem, begin, heat) for heat in _HEATS]
    # where dead reckoning is far off, a redescending kernel may come nearer first
    kernel = solve(problem, begin, kernel=_KERNEL, max_iterations=_KERNEL_STEPS).world_T_pose
    tried.append(_heated(problem, kernel, _HEATS[0]))
    limit = min(_limit(problem, poses) for poses, _ in tried)
    poses, weights = min(tried, key=lambda pair: truncated_cost(problem, pair[0], limit))
    final = solve(problem, poses, weights)
    return Solution(final.world_T_pose, weights, final.chi2_steps, time.process_time() - began, final.arrived)


def dead_reckoning(problem: Problem) -> FloatArray | None:
    """(N, 3): every pose from the one before it by the edge between them, or None where one is missing."""
    n = np.flatnonzero((np.abs(problem.j - problem.i) == 1) & (problem.i < problem.size))
    i, j, i_T_j = problem.i[n], problem.j[n], problem.i_T_j[n]
    steps = np.full((problem.size, 3), np.nan)
    steps[np.maximum(i, j)] = np.where((j > i)[:, None], i_T_j, se2.inverse(i_T_j))
    poses = problem.world_T_pose.copy()
    if not np.isfinite(steps[1:][~problem.held[1:]]).all():
        return None
    for k in np.flatnonzero(~problem.held).tolist():
        if k:
            poses[k] = se2.compose(poses[k - 1], steps[k])
    return poses


def truncated_cost(problem: Problem, world_T_pose: FloatArray, limit: float) -> float:
    """Sum over edges of chi2; a loop costs no more than ``limit``."""
    return float(np.minimum(problem.chi2(world_T_pose), np.where(problem.chain(), np.inf, limit)).sum())


def _heated(problem: Problem, poses: FloatArray, heat: float) -> tuple[FloatArray, FloatArray]:
    limit, weights = LIMIT, np.zeros(len(problem.i))
    for _ in range(_ROUNDS):
        before = weights
        poses, weights = _anneal(problem, poses, heat * LIMIT, limit)
        limit = _limit(problem, poses)
        if np.array_equal(before, weights):
            break
    return poses, weights


def _anneal(problem: Problem, poses: FloatArray, top: float, bottom: float) -> tuple[FloatArray, FloatArray]:
    trusted = problem.chain()
    limit = top
    while True:
        weights = np.where(trusted, 1.0, np.clip(1.0 - problem.chi2(poses) / limit, 0.0, 1.0) ** 2)
        weights[weights < _NO_LOOP] = 0.0
        poses = solve(problem, poses, weights, max_iterations=1).world_T_pose
        if limit <= bottom:
            break
        limit = max(limit / _PACE, bottom)
    weights = np.where(trusted | (problem.chi2(poses) <= bottom), 1.0, 0.0)
    return solve(problem, poses, weights).world_T_pose, weights


def _limit(problem: Problem, poses: FloatArray) -> float:
    """Limit for true loops: `LIMIT`, or less where the loops that agree have less noise than they say."""
    chi2 = problem.chi2(poses)
    agree = chi2[~problem.chain() & (chi2 <= LIMIT)]
    if not len(agree):
        return LIMIT
    return LIMIT * float(np.clip(_SPARE * np.median(agree) / _MEDIAN, 1e-3, 1.0))
