"""Uncertainty along shortest paths bounds the joint marginals from above, by not too much."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mfslam import se2
from mfslam.config import GraphConfig
from mfslam.graph import PoseGraph
from mfslam.types import Edge
from mfslam.uncertainty import LEAST_KNOWN, RelativeUncertainty

INFORMATION = np.diag([1600.0, 1600.0, 2.5e5])


def chain(steps, information=INFORMATION, loops=()):
    """The same edges in a pose graph and in a `RelativeUncertainty`."""
    graph, uncertainty = PoseGraph(GraphConfig(loop_kernel_sigmas=1e6)), RelativeUncertainty()
    graph.add_first(np.zeros(3))
    for k, step in enumerate(steps):
        edge = Edge("scan", k, k + 1, step, information)
        graph.add_keyframe(step, [edge])
        uncertainty.add([edge])
    poses = graph.poses()
    for i, j in loops:
        edge = Edge("loop", i, j, se2.between(poses[i], poses[j]), information)
        graph.add_edge(edge)
        uncertainty.add([edge])
    return graph, uncertainty


def straight(count):
    return np.tile([0.5, 0.0, 0.0], (count, 1))


def circle(count):
    return np.tile(se2.exp(np.array([0.5, 0.0, 2.0 * math.pi / count])), (count, 1))


def sigmas_of(graph, i, j):
    covariance = graph.relative_covariance(i, j)
    return math.sqrt(covariance[0, 0] + covariance[1, 1]), math.sqrt(covariance[2, 2])


def test_one_sees_oneself_surely():
    _, uncertainty = chain(straight(3))
    sigma_m, sigma_rad = uncertainty.seen_from(2, np.cumsum(np.vstack([np.zeros(3), straight(3)]), axis=0))
    assert sigma_m[2] == 0.0 and sigma_rad[2] == 0.0
    assert sigma_m[3] > 0.0


def test_a_straight_chain_in_closed_form():
    """n steps of d m: heading variances add; each turns what follows: v_h d^2 (1 + 4 + ... + (n-1)^2)."""
    graph, uncertainty = chain(straight(30))
    sigma_m, sigma_rad = uncertainty.seen_from(0, graph.poses())
    covariance = np.linalg.inv(INFORMATION + LEAST_KNOWN)
    n = np.arange(31)
    squares = (n - 1) * n * (2 * n - 1) / 6.0
    expected = n * (covariance[0, 0] + covariance[1, 1]) + covariance[2, 2] * 0.25 * squares
    np.testing.assert_allclose(sigma_m**2, expected, rtol=1e-9)
    np.testing.assert_allclose(sigma_rad**2, n * covariance[2, 2], rtol=1e-9)


@pytest.mark.parametrize("steps", [straight(60), circle(60)], ids=["straight", "circle"])
def test_on_a_chain_it_is_the_marginal(steps):
    """Seen from the far end: there the two forms of the lever meet, so 2 % is what first order leaves."""
    graph, uncertainty = chain(steps)
    sigma_m, sigma_rad = uncertainty.seen_from(60, graph.poses())
    for k in (0, 10, 30, 55, 59):
        position, heading = sigmas_of(graph, 60, k)
        assert sigma_m[k] == pytest.approx(position, rel=0.02)
        assert sigma_rad[k] == pytest.approx(heading, rel=0.02)


def test_with_loops_it_bounds_the_marginal_from_above_and_closely():
    graph, uncertainty = chain(circle(80), loops=[(0, 79), (5, 45), (12, 70)])
    for start in (79, 40):
        sigma_m, sigma_rad = uncertainty.seen_from(start, graph.poses())
        for k in range(0, 80, 7):
            if k != start:
                position, heading = sigmas_of(graph, start, k)
                assert 0.98 * position < sigma_m[k] < 2.5 * position, (start, k)
                assert 0.98 * heading < sigma_rad[k] < 2.5 * heading, (start, k)


def test_a_loop_makes_the_start_near_again():
    graph, open_chain = chain(circle(80))
    closed_graph, closed = chain(circle(80), loops=[(0, 80)])
    before = open_chain.seen_from(80, graph.poses())[0]
    after = closed.seen_from(80, closed_graph.poses())[0]
    assert after[0] < 0.2 * before[0]
    assert after[40] == pytest.approx(before[40], rel=0.05)  # half way round it is as far either way
    assert after[78] == pytest.approx(before[78], rel=1e-9)


def test_an_open_direction_is_a_wide_one_not_a_broken_one():
    """A corridor without wheels: nothing known along it. LEAST_KNOWN keeps that at 1 m a step."""
    blind = np.diag([0.0, 1600.0, 2.5e5])
    graph, uncertainty = chain(straight(16), blind)
    sigma_m, _ = uncertainty.seen_from(0, graph.poses())
    assert sigma_m[16] == pytest.approx(4.0, rel=0.05)


def test_keyframes_without_any_edge_to_here_are_anywhere():
    uncertainty = RelativeUncertainty()
    uncertainty.add([Edge("scan", 0, 1, np.array([1.0, 0.0, 0.0]), INFORMATION)])
    sigma_m, _ = uncertainty.seen_from(0, np.zeros((3, 3)))
    assert np.isfinite(sigma_m[1]) and np.isinf(sigma_m[2])


def test_what_the_scans_leave_open_the_wheels_tell():
    """Along a corridor a match knows nothing, the wheels 4 cm a step: 16 steps are 16 cm, not 4 m."""
    uncertainty = RelativeUncertainty()
    step = np.array([0.5, 0.0, 0.0])
    for k in range(16):
        match = Edge("scan", k, k + 1, step, np.diag([0.0, 1e6, 1e8]))
        wheels = Edge("odometry", k, k + 1, step, np.diag([625.0, 625.0, 1e4]))
        uncertainty.add([match, wheels])
    poses = np.zeros((17, 3))
    poses[:, 0] = 0.5 * np.arange(17)
    assert uncertainty.seen_from(0, poses)[0][16] == pytest.approx(0.16, rel=0.02)


def test_a_loop_that_was_taken_out_ties_nothing_any_more():
    steps = straight(40)
    graph, uncertainty = chain(steps, loops=[(0, 40)])
    tied = uncertainty.seen_from(0, graph.poses())[0][40]
    measured = se2.between(graph.poses()[0], graph.poses()[40])
    uncertainty.remove(Edge("loop", 0, 40, measured, INFORMATION))
    loose = uncertainty.seen_from(0, graph.poses())[0][40]
    assert loose == pytest.approx(chain(steps)[1].seen_from(0, graph.poses())[0][40])
    assert tied < 0.5 * loose


def test_on_a_long_log_rows_of_keyframes_tell_nearly_the_same(monkeypatch):
    loops = [(0, 319), (20, 180), (48, 280)]
    graph, exact = chain(circle(320), loops=loops)
    in_rows = chain(circle(320), loops=loops)[1]
    poses = graph.poses()
    exact_m, exact_rad = exact.seen_from(300, poses)
    monkeypatch.setattr("mfslam.uncertainty.SINGLY", 50)
    sigma_m, sigma_rad = in_rows.seen_from(300, poses)
    assert len(sigma_m) == len(exact_m) == 321
    rows = np.s_[:240]
    off = np.stack([sigma_m[rows] / exact_m[rows], sigma_rad[rows] / exact_rad[rows]]) - 1.0
    # where two ways are about as long, another one may be taken
    assert np.median(np.abs(off)) < 0.05 and np.max(np.abs(off)) < 0.3
    measured = se2.between(poses[48], poses[280])
    in_rows.remove(Edge("loop", 48, 280, measured, INFORMATION))
    assert in_rows.seen_from(300, poses)[0][48] > 1.2 * sigma_m[48]


def test_on_a_long_log_a_new_loop_counts_at_once(monkeypatch):
    monkeypatch.setattr("mfslam.uncertainty.SINGLY", 50)
    graph, uncertainty = chain(circle(80))
    poses = graph.poses()
    before_m, _ = uncertainty.seen_from(80, poses)
    uncertainty.add([Edge("loop", 0, 80, se2.between(poses[0], poses[80]), INFORMATION)])
    after_m, _ = uncertainty.seen_from(80, poses)
    assert after_m[0] < 0.5 * before_m[0]
