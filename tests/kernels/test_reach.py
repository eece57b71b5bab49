"""Covariances along surest paths, against a chain in closed form and against sampled motion."""

import numpy as np
import pytest

from mfslam import se2
from mfslam.kernels import reach

NOTHING = np.zeros((3, 3))


def rows_of(count, ties, most=np.inf):
    """The linked ends of ties (i, j, covariance of j seen from i), their covariances, and what a path may cost."""
    ends = np.array([tie[:2] for tie in ties], dtype=np.int64).ravel()
    newest, older = np.full(count, -1, np.int64), np.empty(len(ends), np.int64)
    for end, pose in enumerate(ends):
        older[end], newest[pose] = newest[pose], end
    return newest, older, ends, np.array([tie[2] for tie in ties]).reshape(-1, 3, 3), most


def test_a_straight_chain():
    """Steps of 2 m: each heading error turns the steps that follow it: b 2^2 (0 + 1 + 4 + ...)."""
    poses = np.array([[2.0 * k, 0.0, 0.0] for k in range(5)])
    a, b = 1e-4, 2e-5
    out, cost = reach.path_covariances(
        0, NOTHING, poses, *rows_of(5, [(k, k + 1, np.diag([a, a, b])) for k in range(4)])
    )
    steps_left = [0, 0, 1, 1 + 4, 1 + 4 + 9]
    for k in range(5):
        np.testing.assert_allclose(
            np.diag(out[k]), [k * a, k * a + 4.0 * b * steps_left[k], k * b], atol=1e-15
        )
        assert cost[k] == pytest.approx(k * (2.0 * a + reach.LEVER_M**2 * b))


@pytest.mark.parametrize("backwards", [False, True])
def test_a_chain_around_a_corner_against_sampled_motion(backwards):
    """Either way along the ties, and from a start that is not known exactly itself."""
    rng = np.random.default_rng(11)
    steps = np.array([[3.0, 0.0, 0.0], [2.0, 1.0, 1.2], [4.0, 0.0, 0.3], [5.0, -1.0, -2.0]])
    poses = [np.zeros(3)]
    for step in steps:
        poses.append(se2.compose(poses[-1], step))
    covariance = np.diag([3e-4, 1e-4, 4e-5])
    ties = [(k, k + 1, covariance) for k in range(4)]
    if backwards:
        poses, ties = poses[::-1], [(4 - a, 3 - a, covariance) for a in range(4)]
    start = np.diag([1e-4, 2e-4, 1e-5])
    out, _ = reach.path_covariances(0, start, np.array(poses), *rows_of(5, ties))

    def noise(of):
        return se2.exp(rng.multivariate_normal(np.zeros(3), of, 20_000))

    ends = se2.compose(poses[0], noise(start))
    for k in range(4):
        step = se2.between(poses[k], poses[k + 1])
        measured = (
            se2.inverse(se2.compose(se2.inverse(step), noise(covariance)))
            if backwards
            else se2.compose(step, noise(covariance))
        )
        ends = se2.compose(ends, measured)
    sampled = np.cov(se2.log(se2.between(poses[4], ends)).T)
    np.testing.assert_allclose(out[4], sampled, atol=0.05 * float(sampled.max()))


def test_the_surest_path_counts_and_islands_are_out_of_reach():
    poses = np.array([[float(k), 0.0, 0.0] for k in range(5)])
    sizes = [(0, 1, 1.0), (1, 2, 1.0), (2, 3, 1.0), (0, 3, 0.5), (0, 1, 3.0)]
    ties = [(i, j, np.diag([size, 0.0, 0.0])) for i, j, size in sizes]
    out, cost = reach.path_covariances(0, NOTHING, poses, *rows_of(5, ties))
    np.testing.assert_allclose(out[:4, 0, 0], [0.0, 1.0, 1.5, 0.5])
    assert np.all(np.isinf(out[4])) and np.isinf(cost[4])
    out, cost = reach.path_covariances(0, NOTHING, poses, *rows_of(5, ties, 1.2))
    np.testing.assert_array_equal(cost, [0.0, 1.0, np.inf, 0.5, np.inf])
