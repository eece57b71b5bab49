"""A pose graph with false loops, solved by graduated non-convexity.

Every loop outside the odometry chain has Tukey's weight (1 - chi2 / L)^2, none above L. L falls from far above
to what chi2 of a true loop allows, one step of least squares each time, so loops are refused only when those that
agree have pulled the graph together. What makes it hold where plain schedules fail:

- it begins at dead reckoning, at a graph built up along the path and at one whose loops were as soft as the drift
  between their ends (`robust_starts`), never at a least-squares solve that false loops have folded already; the
  result with the lowest truncated cost is kept;
- it is heated again: what was refused beside a false loop may come back once that one is gone;
- noise that is smaller than the file says is seen in the loops that agree, and L then falls further:
  under noise models forty times too wide a chain bends to a false loop at no cost.
"""

from __future__ import annotations

import time

import numpy as np
from scipy.stats import chi2 as chi2_distribution

from mfslam import se2
from mfslam.graph.batch import Solution, solve
from mfslam.graph.robust_starts import annealed, drift_annealed, grown, steps_of_chain
from mfslam.pose_graphs.data import Problem
from mfslam.types import FloatArray

LIMIT = float(chi2_distribution.ppf(0.99, 3))  # chi2 of a true loop
_SEEN = (0.5, 0.95)  # shares of the loops whose chi2 tells how wide the noise is
_EXPECTED = chi2_distribution.ppf(_SEEN, 3)
_HEAT = 10.0  # times LIMIT
_ROUNDS = 3
_SPARE = 3.0  # noise of real loops has wider tails than most of them tell
_NARROWEST = 1e-3  # of LIMIT
_SAME = 1.3  # ratio of two limits that are one


def solve_robust(problem: Problem, start: FloatArray) -> Solution:
    """Poses, and weights 1 (believed) or 0 (refused) of all edges; chi2 steps are of the believed ones.

    ``start`` (N, 3) is used where the chain of odometry is broken. Raises MfslamError when the edges leave
    a pose open.
    """
    began = time.process_time()
    if problem.chain().all():
        return solve(problem, start)
    reckoned = dead_reckoning(problem)
    if reckoned is None:
        tried = [_heated(problem, start)]
    else:
        grown_poses = grown(problem, reckoned, _HEAT * LIMIT, LIMIT)
        tried = [_heated(problem, poses) for poses in (grown_poses, reckoned, _eased(problem, reckoned))]
    limit = min(_limit(problem, poses) for poses, _ in tried)
    poses, weights = min(tried, key=lambda pair: truncated_cost(problem, pair[0], limit))
    final = solve(problem, poses, weights)
    return Solution(final.world_T_pose, weights, final.chi2_steps, time.process_time() - began, final.arrived)


def dead_reckoning(problem: Problem) -> FloatArray | None:
    """(N, 3): every pose from the one before it by the edge between them, or None where one is missing."""
    n = np.flatnonzero(steps_of_chain(problem))
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


def _heated(problem: Problem, poses: FloatArray) -> tuple[FloatArray, FloatArray]:
    limit, weights = LIMIT, np.zeros(len(problem.i))
    trusted = problem.chain()
    for _ in range(_ROUNDS):
        before = weights
        poses = annealed(problem, poses, _HEAT * LIMIT, limit)
        weights = np.where(trusted | (problem.chi2(poses) <= limit), 1.0, 0.0)
        poses = solve(problem, poses, weights).world_T_pose
        limit = _limit(problem, poses)
        if np.array_equal(before, weights):
            break
    return poses, weights


def _eased(problem: Problem, reckoned: FloatArray) -> FloatArray:
    """Loops as soft as the drift between their ends at first, again under the noise that was found."""
    limit = LIMIT
    for _ in range(_ROUNDS):
        poses = drift_annealed(problem, reckoned, limit)
        before, limit = limit, _limit(problem, poses)
        if max(before, limit) < _SAME * min(before, limit):
            break
    return poses


def _limit(problem: Problem, poses: FloatArray) -> float:
    """Limit for true loops: `LIMIT`, or less where the loops that agree have less noise than they say."""
    chi2 = problem.chi2(poses)
    agree = chi2[~problem.chain() & (chi2 <= LIMIT)]
    if not len(agree):
        return LIMIT
    wide = float(np.max(np.quantile(agree, _SEEN) / _EXPECTED))
    return LIMIT * float(np.clip(_SPARE * wide, _NARROWEST, 1.0))
