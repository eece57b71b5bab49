"""Uncertainty along shortest paths, against chains worked out by hand and by Monte Carlo."""

import numpy as np
import pytest

from mfslam import se2
from mfslam.kernels import reach


def rows_of(count, edges):
    """The linked ends of undirected edges (i, j, position, heading variance), and their variances."""
    ends = np.array([e[:2] for e in edges], dtype=np.int64).ravel()
    newest, older = np.full(count, -1, np.int64), np.empty(len(ends), np.int64)
    for end, keyframe in enumerate(ends):
        older[end], newest[keyframe] = newest[keyframe], end
    return newest, older, ends, np.array([e[2:] for e in edges], dtype=float).reshape(-1, 2)


def test_a_straight_chain():
    """Steps of 2 m: each heading error turns the steps that follow it: b 2^2 (0 + 1 + 4 + ...)."""
    poses = np.array([[2.0 * k, 0.0, 0.0] for k in range(5)])
    a, b = 1e-4, 2e-5
    out = reach.relative_sigmas(0, poses, *rows_of(5, [(k, k + 1, a, b) for k in range(4)]))
    steps_left = [0, 0, 1, 1 + 4, 1 + 4 + 9]
    for k in range(5):
        assert out[k, 0] == pytest.approx(k * a + 4.0 * b * steps_left[k])
        assert out[k, 1] == pytest.approx(k * b)
        assert out[k, 2] == pytest.approx(k * (a + reach.LEVER_M**2 * b))


def test_a_chain_around_a_corner_against_sampled_motion():
    rng = np.random.default_rng(11)
    steps = [
        np.array([3.0, 0.0, 0.0]),
        np.array([2.0, 1.0, 1.2]),
        np.array([4.0, 0.0, 0.3]),
        np.array([5.0, -1.0, -2.0]),
    ]
    poses = [np.zeros(3)]
    for step in steps:
        poses.append(se2.compose(poses[-1], step))
    position, heading = 2e-4, 4e-5
    out = reach.relative_sigmas(
        0, np.array(poses), *rows_of(5, [(k, k + 1, position, heading) for k in range(4)])
    )
    ends = np.zeros((20_000, 3))
    sigmas = np.sqrt([position / 2, position / 2, heading])
    for step in steps:
        ends = se2.compose(se2.compose(ends, step), rng.normal(size=ends.shape) * sigmas)
    error = ends[:, :2] - poses[-1][:2]
    assert out[4, 0] == pytest.approx(np.mean(np.sum(error**2, axis=1)), rel=0.05)
    assert out[4, 1] == pytest.approx(np.var(se2.wrap(ends[:, 2] - poses[-1][2])), rel=0.05)


def test_the_surest_path_counts_and_islands_are_out_of_reach():
    poses = np.array([[float(k), 0.0, 0.0] for k in range(5)])
    edges = [(0, 1, 1.0, 0.0), (1, 2, 1.0, 0.0), (2, 3, 1.0, 0.0), (0, 3, 0.5, 0.0), (0, 1, 3.0, 0.0)]
    out = reach.relative_sigmas(0, poses, *rows_of(5, edges))
    np.testing.assert_allclose(out[:4, 0], [0.0, 1.0, 1.5, 0.5])
    assert np.all(np.isinf(out[4]))
