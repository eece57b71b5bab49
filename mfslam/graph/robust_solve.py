"""Batch solves that decide which loops to believe: graduated non-convexity (Yang et al. 2020), truncated
least squares."""

from __future__ import annotations

from collections.abc import Sequence

import gtsam


def graduated_solve(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    doubtful: Sequence[int],
    inlier_probability: float,
) -> gtsam.Values:
    """Solution of ``graph`` without the outliers among its ``doubtful`` factors (slots); the others are believed."""
    if not doubtful:
        return gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    params = gtsam.GncLMParams()
    params.setLossType(gtsam.GncLossType.TLS)
    # the default schedule: the faster one believes false loops where true ones are few
    params.setScheduler(gtsam.GncScheduler.Linear)
    params.setKnownInliers(sorted(set(range(graph.size())) - set(doubtful)))
    gnc = gtsam.GncLMOptimizer(graph, values, params)
    gnc.setInlierCostThresholdsAtProbability(inlier_probability)
    return gnc.optimize()
