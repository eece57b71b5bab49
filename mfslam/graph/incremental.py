"""A pose graph solved as a robot would: one pose at a time, in the file's order, by iSAM2."""

from __future__ import annotations

import time
from dataclasses import dataclass

import gtsam
import numpy as np

from mfslam import se2
from mfslam.graph.batch import factor_graph
from mfslam.pose_graphs.data import Problem
from mfslam.types import FloatArray, IntArray, MfslamError

RELINEARIZE_THRESHOLD = 0.05  # m or rad


@dataclass(frozen=True, eq=False)
class IncrementalRun:
    """``online`` (N, 3): each pose as it was believed when it came; ``world_T_pose``: as all were at the end.

    ``update_s`` (N,): seconds that each update took, its estimate included, by the clock: what a robot waits.
    """

    world_T_pose: FloatArray
    online: FloatArray
    update_s: FloatArray


def solve_incrementally(problem: Problem, relinearize_skip: int = 1) -> IncrementalRun:
    """Add every pose with the edges to poses before it, update, and read the newest pose back.

    A pose begins where the first of its edges puts it. Raises MfslamError when an edge is needed to say
    where a pose is and there is none yet.
    """
    graph = factor_graph(problem)
    newest = np.maximum(np.where(problem.i == problem.size, -1, problem.i), problem.j)
    order = np.argsort(newest, kind="stable")
    starts = np.searchsorted(newest[order], np.arange(problem.size + 1))
    holds = {int(n): graph.at(len(problem.i) + k) for k, n in enumerate(np.flatnonzero(problem.held))}
    params = gtsam.ISAM2Params()
    params.setRelinearizeThreshold(RELINEARIZE_THRESHOLD)
    params.relinearizeSkip = relinearize_skip
    isam = gtsam.ISAM2(params)
    online = np.zeros((problem.size, 3))
    update_s = np.zeros(problem.size)
    for n in range(problem.size):
        edges = order[starts[n] : starts[n + 1]]
        new, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        for e in edges.tolist():
            new.add(graph.at(e))
        if n in holds:
            new.add(holds[n])
        values.insert(n, gtsam.Pose2(*_first_guess(problem, n, edges, online)))
        began = time.perf_counter()
        try:
            isam.update(new, values)
            pose = isam.calculateEstimatePose2(n)
        except (RuntimeError, IndexError) as error:
            raise MfslamError(
                f"iSAM2 cannot take pose number {n} (from 0): {str(error).strip().splitlines()[0]}"
            ) from None
        update_s[n] = time.perf_counter() - began
        online[n] = pose.x(), pose.y(), pose.theta()
    for _ in range(3):  # what relinearisation still owes
        isam.update()
    return IncrementalRun(gtsam.utilities.extractPose2(isam.calculateEstimate()), online, update_s)


def _first_guess(problem: Problem, n: int, edges: IntArray, online: FloatArray) -> FloatArray:
    """Where an edge from the pose before puts pose n, or else its first edge."""
    if problem.held[n] or not len(edges):
        if not problem.held[n]:
            raise MfslamError(
                f"pose number {n} (from 0) has no edge to a pose before it: without --incremental the order does not matter"
            )
        return np.asarray(problem.world_T_pose[n])
    i, j = problem.i[edges], problem.j[edges]
    best = int(edges[np.argmax(np.where(i == problem.size, -1, np.minimum(i, j)))])
    i_T_j = problem.i_T_j[best]
    if problem.i[best] == problem.size:
        return np.asarray(i_T_j)
    if problem.j[best] == n:
        return se2.compose(online[problem.i[best]], i_T_j)
    return se2.compose(online[problem.j[best]], se2.inverse(i_T_j))
