"""Batch least squares of a pose graph that came from a file."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import gtsam
import numpy as np

import factors
from mfslam.graph.gauss_newton import step
from mfslam.pose_graphs.data import Problem
from mfslam.types import FloatArray, MfslamError

HELD_SIGMAS = np.full(3, 1e-4)  # of a pose that only says where the graph is: it costs nothing to hold it
_SAME = 1e-5  # relative decrease of chi2 at which a solve has arrived, as in gtsam
_STUCK = 0.99  # of chi2: what a step from an optimum cannot reach
_NOTHING = 1e-10  # chi2 that is zero but for rounding
MAX_ITERATIONS = 200


@dataclass(frozen=True, eq=False)
class Solution:
    """Poses (N, 3) of a solve; ``weights`` (E,) that it left to the edges; chi2 after each iteration."""

    world_T_pose: FloatArray
    weights: FloatArray
    chi2_steps: list[float] = field(default_factory=list)
    cpu_s: float = 0.0
    arrived: bool = True

    @property
    def iterations(self) -> int:
        return max(len(self.chi2_steps) - 1, 0)


def factor_graph(
    problem: Problem, weights: FloatArray | None = None, kernel: tuple[str, float] | None = None
) -> gtsam.NonlinearFactorGraph:
    """gtsam's factors of all edges of weight above zero, and what holds the poses that do not move.

    ``kernel``: name and scale in sigmas, for edges outside the chain of odometry.
    """
    graph = gtsam.NonlinearFactorGraph()
    noise = _Noises(problem, kernel)
    heads, tails, poses = problem.i.tolist(), problem.j.tolist(), problem.i_T_j.tolist()
    chosen = range(len(heads)) if weights is None else np.flatnonzero(weights > 0).tolist()
    scale = None if weights is None else weights.tolist()
    world = problem.size
    for n in chosen:
        i, j, pose = heads[n], tails[n], gtsam.Pose2(*poses[n])
        model = noise(n, 1.0 if scale is None else scale[n])
        graph.add(
            gtsam.PriorFactorPose2(j, pose, model)
            if i == world
            else gtsam.BetweenFactorPose2(i, j, pose, model)
        )
    for n in np.flatnonzero(problem.held).tolist():
        graph.add(_hold(n, problem.world_T_pose[n], alone=int(problem.held.sum()) == 1))
    return graph


def _hold(n: int, world_T_pose: FloatArray, alone: bool) -> gtsam.PriorFactorPose2:
    """One held pose only says where the graph is, so a soft hold is exact; several pull against each other."""
    if alone:
        return factors.prior_factor(n, world_T_pose, HELD_SIGMAS)
    return gtsam.PriorFactorPose2(n, gtsam.Pose2(*world_T_pose), gtsam.noiseModel.Constrained.All(3))


class _Noises:
    """Noise models of edges; edges of the same information and weight share one."""

    def __init__(self, problem: Problem, kernel: tuple[str, float] | None) -> None:
        distinct, self._group = np.unique(problem.information.reshape(-1, 9), axis=0, return_inverse=True)
        self._information = distinct.reshape(-1, 3, 3)
        eigenvalues = np.linalg.eigvalsh(self._information)
        # gtsam reads these rightly; (nearly) singular ones are made a little wider
        self._regular = (eigenvalues[:, 0] > 1e-9 * eigenvalues[:, 2]).tolist()
        self._groups = self._group.reshape(-1).tolist()
        self._made: dict[tuple[int, float, bool], gtsam.noiseModel.Base] = {}
        self._kernel = kernel
        self._trusted = problem.chain().tolist()

    def __call__(self, n: int, weight: float) -> gtsam.noiseModel.Base:
        robust = self._kernel is not None and not self._trusted[n]
        key = (self._groups[n], weight, robust)
        model = self._made.get(key)
        if model is None:
            information = weight * self._information[key[0]]
            model = (
                gtsam.noiseModel.Gaussian.Information(information)
                if self._regular[key[0]]
                else factors.noise_from_information(information)
            )
            if robust and self._kernel is not None:
                model = factors.robust_noise(model, *self._kernel)
            self._made[key] = model
        return model


def values_of(world_T_pose: FloatArray) -> gtsam.Values:
    values = gtsam.Values()
    for key, pose in enumerate(world_T_pose.tolist()):
        values.insert(key, gtsam.Pose2(*pose))
    return values


def _poses_of(values: gtsam.Values) -> FloatArray:
    return np.asarray(gtsam.utilities.extractPose2(values))


def solve(
    problem: Problem,
    start: FloatArray,
    weights: FloatArray | None = None,
    kernel: tuple[str, float] | None = None,
    max_iterations: int = MAX_ITERATIONS,
) -> Solution:
    """Levenberg-Marquardt from poses (N, 3) until chi2 no longer falls by more than 1e-5 of itself.

    Raises MfslamError when the edges leave a pose open.
    """
    began = time.process_time()
    graph, values = factor_graph(problem, weights, kernel), values_of(start)
    poses, steps, arrived = _levenberg_marquardt(graph, values, max_iterations)
    used = np.ones(len(problem.i)) if weights is None else weights
    if (
        kernel is None and len(steps) == 2
    ):  # it stands still: at the optimum, or too far away for gtsam's pivots
        moved = step(problem, poses, used)
        if float(used @ problem.chi2(moved)) < _STUCK * steps[-1]:
            poses, more, arrived = _levenberg_marquardt(graph, values_of(moved), max_iterations)
            steps += more
    if kernel is not None:
        used = used * kernel_weights(problem, poses, kernel)
    return Solution(poses, used, steps, time.process_time() - began, arrived)


def _levenberg_marquardt(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, max_iterations: int
) -> tuple[FloatArray, list[float], bool]:
    optimizer = gtsam.LevenbergMarquardtOptimizer(graph, values)
    steps = [2.0 * optimizer.error()]
    arrived = steps[0] <= _NOTHING
    try:
        while not arrived and len(steps) <= max_iterations:
            optimizer.iterate()
            steps.append(2.0 * optimizer.error())
            arrived = steps[-2] - steps[-1] <= _SAME * steps[-2] + _NOTHING
    except RuntimeError as error:
        raise MfslamError(
            f"the edges leave a pose open, so there is no one best graph (gtsam: {str(error).strip().splitlines()[0]})"
        ) from None
    if not np.isfinite(steps[-1]):
        raise MfslamError("chi2 is not finite: the poses or edges of this graph are out of any range")
    values = optimizer.values()
    return _poses_of(values), steps, bool(arrived)


def kernel_weights(problem: Problem, world_T_pose: FloatArray, kernel: tuple[str, float]) -> FloatArray:
    """What a kernel leaves of every edge at poses (N, 3); edges of the chain keep all."""
    name, scale = kernel
    r = np.sqrt(problem.chi2(world_T_pose)) / scale
    weight = {
        "huber": 1.0 / np.maximum(r, 1.0),
        "cauchy": 1.0 / (1.0 + r**2),
        "geman-mcclure": 1.0 / (1.0 + r**2) ** 2,
        "dcs": np.minimum(1.0, 2.0 / (1.0 + r**2)) ** 2,
        "tls": (r <= 1.0).astype(np.float64),
    }[name]
    return np.where(problem.chain(), 1.0, weight)
