"""Marginal covariances of the solved graph: closed forms, and gtsam's own."""

from __future__ import annotations

import gtsam
import numpy as np

import factors
from mfslam import se2
from mfslam.graph import GraphInformation
from mfslam.types import Edge, FloatArray


def line(count: int) -> FloatArray:
    """Poses 1 m apart along x."""
    return np.column_stack([np.arange(float(count)), np.zeros(count), np.zeros(count)])


def step(i: int, j: int, poses: FloatArray, information: FloatArray, weight: float = 1.0) -> Edge:
    return Edge("scan", i, j, se2.between(poses[i], poses[j]), information, weight)


def test_a_chain_adds_up_and_a_heading_error_acts_with_the_distance() -> None:
    poses, sigma_m, sigma_rad = line(6), 0.01, 0.002
    information = np.diag([sigma_m**-2, sigma_m**-2, sigma_rad**-2])
    covariances = GraphInformation(poses, [step(k, k + 1, poses, information) for k in range(5)]).marginals()
    assert not covariances[0].any()  # the first pose is the origin
    last = covariances[5]
    assert np.allclose(last[0, 0], 5 * sigma_m**2)
    assert np.allclose(last[2, 2], 5 * sigma_rad**2)
    levers = np.arange(5)  # from each joint's far end to the last pose
    assert np.allclose(last[1, 1], 5 * sigma_m**2 + sigma_rad**2 * np.sum(levers**2))


def test_two_edges_of_one_kind_halve_the_variance_and_a_refused_one_adds_nothing() -> None:
    poses, information = line(2), np.diag([1e4, 1e4, 1e5])
    one = GraphInformation(poses, [step(0, 1, poses, information)]).marginals()[1]
    two = GraphInformation(poses, [step(0, 1, poses, information)] * 2).marginals()[1]
    refused = [step(0, 1, poses, information), step(0, 1, poses, information, weight=0.0)]
    assert np.allclose(two, 0.5 * one)
    assert np.allclose(GraphInformation(poses, refused).marginals()[1], one)


def test_agrees_with_gtsam_on_a_random_graph_with_loops_and_headings() -> None:
    rng = np.random.default_rng(4)
    steps = np.column_stack([np.full(39, 0.5), np.zeros(39), rng.normal(0, 0.3, 39)])
    chain = [np.zeros(3)]
    for move in steps:
        chain.append(se2.compose(chain[-1], move))
    poses = np.array(chain)
    edges, graph, values = [], gtsam.NonlinearFactorGraph(), gtsam.Values()
    pairs = [(k - d, k) for k in range(1, 40) for d in (1, 2) if k >= d] + [(0, 30), (25, 5), (12, 39)]
    for i, j in pairs:
        root = rng.normal(size=(3, 3))
        edges.append(step(i, j, poses, 100.0 * root @ root.T + np.eye(3)))
        graph.add(factors.scan_match_factor(i, j, edges[-1].i_T_j, edges[-1].information))
    edges.append(Edge("heading", 7, 9, se2.between(poses[7], poses[9]), np.diag([0.0, 0.0, 400.0])))
    graph.add(factors.gyro_factor(7, 9, float(edges[-1].i_T_j[2]), 0.05))
    edges.append(Edge("heading", 20, 20, np.array([0.0, 0.0, poses[20, 2]]), np.diag([0.0, 0.0, 100.0])))
    graph.add(factors.compass_factor(20, float(poses[20, 2]), 0.1))
    graph.add(factors.prior_factor(0, poses[0], np.full(3, 1e-6)))
    for key, pose in enumerate(poses):
        values.insert(key, gtsam.Pose2(*pose))
    theirs = gtsam.Marginals(graph, values)
    information = GraphInformation(poses, edges)
    ours = information.marginals()
    dense = np.linalg.inv(information.matrix().toarray())
    for k in range(1, 40):
        assert np.allclose(ours[k], theirs.marginalCovariance(k), rtol=1e-3, atol=1e-9)
        assert np.allclose(ours[k], dense[3 * k - 3 : 3 * k, 3 * k - 3 : 3 * k], rtol=1e-6, atol=1e-12)


def test_one_keyframe_is_the_origin() -> None:
    assert not GraphInformation(np.zeros((1, 3)), []).marginals().any()


def test_the_motion_between_two_poses_is_surer_than_both_seen_from_the_start() -> None:
    poses, sigma_m = line(6), 0.01
    information = np.diag([sigma_m**-2, sigma_m**-2, 1e8])
    graph = GraphInformation(poses, [step(k, k + 1, poses, information) for k in range(5)])
    pairs = np.array([[0, 5], [3, 5], [5, 3]])
    covariances = graph.relative_covariances(pairs[:, 0], pairs[:, 1])
    np.testing.assert_allclose(covariances[0], graph.marginals()[5], rtol=1e-6)
    np.testing.assert_allclose(covariances[1:, 0, 0], 2 * sigma_m**2, rtol=1e-3)
