"""Batch solves that decide which loops to believe: graduated non-convexity (Yang et al. 2020), truncated
least squares."""

from __future__ import annotations

from collections.abc import Sequence

import gtsam
import numpy as np

from mfslam.types import FloatArray


def graduated_solve(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    doubtful: Sequence[int],
    inlier_probability: float,
) -> tuple[gtsam.Values, FloatArray]:
    """Solution and weight (F,) of each factor of ``graph``; those not in ``doubtful`` (slots) are believed."""
    if not doubtful:
        return gtsam.LevenbergMarquardtOptimizer(graph, values).optimize(), np.ones(graph.size())
    params = gtsam.GncLMParams()
    params.setLossType(gtsam.GncLossType.TLS)
    # the default schedule: the faster one believes false loops where true ones are few
    params.setScheduler(gtsam.GncScheduler.Linear)
    params.setKnownInliers(sorted(set(range(graph.size())) - set(doubtful)))
    gnc = gtsam.GncLMOptimizer(graph, values, params)
    gnc.setInlierCostThresholdsAtProbability(inlier_probability)
    solution = gnc.optimize()
    return solution, np.asarray(gnc.getWeights(), dtype=np.float64)
