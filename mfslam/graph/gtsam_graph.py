"""The graph of a run in gtsam: for its solvers, and to hold ours against them."""

from __future__ import annotations

from collections.abc import Iterable

import gtsam
import numpy as np

import factors
from mfslam.types import Edge, FloatArray

HELD_SIGMAS = np.full(3, 1e-6)  # of the first pose, which defines the world


def gtsam_graph(
    world_T_body: FloatArray, edges: Iterable[Edge], loop_kernel_sigmas: float
) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """Native factors of all edges, loops under a Cauchy kernel, and poses (K, 3) as values; keys are keyframe numbers."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.add(factors.prior_factor(0, world_T_body[0], HELD_SIGMAS))
    for edge in edges:
        graph.add(_factor(edge, loop_kernel_sigmas))
    for key, pose in enumerate(world_T_body.tolist()):
        values.insert(key, gtsam.Pose2(*pose))
    return graph, values


def _factor(edge: Edge, loop_kernel_sigmas: float) -> gtsam.NonlinearFactor:
    if edge.kind == "heading":
        sigma_rad = float(edge.information[2, 2]) ** -0.5
        if edge.i == edge.j:
            return factors.compass_factor(edge.i, float(edge.i_T_j[2]), sigma_rad)
        return factors.gyro_factor(edge.i, edge.j, float(edge.i_T_j[2]), sigma_rad)
    make = factors.wheel_odometry_factor if edge.kind == "odometry" else factors.scan_match_factor
    factor = make(edge.i, edge.j, edge.i_T_j, edge.information)
    if edge.kind != "loop":
        return factor
    noise = factors.robust_noise(factor.noiseModel(), "cauchy", loop_kernel_sigmas)
    return gtsam.BetweenFactorPose2(edge.i, edge.j, gtsam.Pose2(*edge.i_T_j), noise)
