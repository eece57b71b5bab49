"""Every factor: its residual, and what it does in a small solve."""

import math
from itertools import pairwise

import gtsam
import numpy as np
import pytest

import factors
from mfslam import se2
from mfslam.config import OdometryConfig
from mfslam.wheel_errors import WheelErrors, WheelStep


def values_of(*poses):
    values = gtsam.Values()
    for key, pose in enumerate(poses):
        values.insert(key, gtsam.Pose2(*pose))
    return values


def solve(parts, *start):
    graph = gtsam.NonlinearFactorGraph()
    for part in parts:
        graph.add(part)
    params = gtsam.LevenbergMarquardtParams()
    params.setRelativeErrorTol(1e-15)
    params.setAbsoluteErrorTol(1e-18)
    solved = gtsam.LevenbergMarquardtOptimizer(graph, values_of(*start), params).optimize()
    return [np.array([p.x(), p.y(), p.theta()]) for p in map(solved.atPose2, range(len(start)))]


AT_ORIGIN = factors.prior_factor(0, np.zeros(3), np.full(3, 1e-6))


@pytest.mark.parametrize("make", [factors.scan_match_factor, factors.wheel_odometry_factor])
def test_between_residual_is_the_log_of_the_difference(make):
    """chi2 = e^T I e with e = log(measured^-1 (world_T_i^-1 world_T_j)); gtsam's error is half of it."""
    world_T_i, i_T_j, off = (
        np.array([2.0, 1.0, 0.7]),
        np.array([1.0, 0.2, 0.3]),
        np.array([0.03, -0.02, 0.04]),
    )
    turn = np.array([[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
    information = turn @ np.diag([900.0, 100.0, 2500.0]) @ turn.T
    world_T_j = se2.compose(se2.compose(world_T_i, i_T_j), se2.exp(off))
    factor = make(0, 1, i_T_j, information)
    assert 2.0 * factor.error(values_of(world_T_i, world_T_j)) == pytest.approx(
        off @ information @ off, rel=1e-7
    )
    assert factor.error(values_of(world_T_i, se2.compose(world_T_i, i_T_j))) == pytest.approx(0.0, abs=1e-18)


def test_wheels_decide_along_a_corridor_and_scans_across():
    """The scan match says 3 m with no information along x; the wheels say 1 m and drift sideways."""
    scan = factors.scan_match_factor(0, 1, np.array([3.0, 0.02, 0.0]), np.diag([0.0, 1e5, 1e6]))
    wheels = factors.wheel_odometry_factor(0, 1, np.array([1.0, 0.3, 0.02]), np.diag([400.0, 100.0, 100.0]))
    _, pose = solve([AT_ORIGIN, scan, wheels], np.zeros(3), np.array([2.0, 0.0, 0.0]))
    np.testing.assert_allclose(pose, [1.0, 0.02, 0.0], atol=5e-3)


def test_distrusted_wheels_keep_almost_no_weight():
    scan = factors.scan_match_factor(0, 1, np.array([1.0, 0.0, 0.0]), np.diag([400.0, 400.0, 400.0]))
    wheels = np.array([2.0, 0.5, 0.0])
    for distrusted, most_m in ((False, 2.0), (True, 1e-3)):
        errors = WheelErrors(OdometryConfig(white_share=1.0))
        _, (information,) = errors.factors([WheelStep(wheels, wheels, np.eye(3), jumped=distrusted)])
        _, pose = solve(
            [AT_ORIGIN, scan, factors.wheel_odometry_factor(0, 1, wheels, information)],
            np.zeros(3),
            np.zeros(3),
        )
        pulled_m = math.hypot(pose[0] - 1.0, pose[1])
        assert most_m / 100.0 < pulled_m < most_m


def test_gyro_turns_and_leaves_translation_free():
    """However sure the gyro, a translation known to a kilometre is not moved by it."""
    vague = factors.scan_match_factor(0, 1, np.array([5.0, 2.0, 0.1]), np.diag([1e-6, 1e-6, 1e-2]))
    gyro = factors.gyro_factor(0, 1, 0.3, 1e-6)
    _, pose = solve([AT_ORIGIN, vague, gyro], np.zeros(3), np.array([4.0, 1.0, 0.0]))
    assert pose[2] == pytest.approx(0.3, abs=1e-6)
    # the between measurement is met in its tangent: only its own heading error bends the arc
    translation = gyro.noiseModel().whiten(np.array([5.0, 2.0, 0.0]))
    np.testing.assert_array_equal(translation, np.zeros(3))
    assert math.hypot(pose[0], pose[1]) == pytest.approx(math.hypot(5.0, 2.0), rel=0.01)


def test_gyro_residual_takes_the_short_way():
    gyro = factors.gyro_factor(0, 1, 3.1, 0.1)
    error = gyro.error(values_of([0.0, 0.0, 0.1], [7.0, -3.0, 0.1 - 3.1]))
    assert 2.0 * error == pytest.approx(((2.0 * math.pi - 6.2) / 0.1) ** 2, rel=1e-9)


def test_compass_turns_a_pose_where_it_stands():
    start = factors.prior_factor(0, np.array([3.0, -2.0, 0.0]), np.array([1e-3, 1e-3, 1.0]))
    (pose,) = solve([start, factors.compass_factor(0, 3.0, 0.01)], np.array([3.0, -2.0, 0.5]))
    np.testing.assert_allclose(pose[:2], [3.0, -2.0], atol=1e-3)
    assert pose[2] == pytest.approx(3.0 * 1e4 / (1e4 + 1.0), abs=1e-6)


def test_prior_residual_and_weights():
    prior = factors.prior_factor(0, np.array([1.0, 2.0, math.pi / 2]), np.array([0.1, 0.2, 0.05]))
    off = np.array([0.05, 0.1, 0.02])
    moved = se2.compose(np.array([1.0, 2.0, math.pi / 2]), se2.exp(off))
    assert 2.0 * prior.error(values_of(moved)) == pytest.approx(0.5**2 + 0.5**2 + 0.4**2, rel=1e-9)


def test_a_square_of_wheel_steps_closes_by_a_loop():
    """Four sides that drift by 2 cm and 1 deg each; a sure loop spreads the error evenly."""
    side = np.array([1.02, 0.0, math.pi / 2 + math.radians(1.0)])
    parts = [AT_ORIGIN]
    start = [np.zeros(3)]
    for k in range(4):
        parts.append(factors.wheel_odometry_factor(k, k + 1, side, np.diag([1e3, 1e3, 1e3])))
        start.append(se2.compose(start[-1], side))
    parts.append(factors.scan_match_factor(0, 4, np.zeros(3), np.diag([1e8, 1e8, 1e8])))
    solved = solve(parts, *start)
    np.testing.assert_allclose(solved[4], 0.0, atol=1e-3)
    lengths = [math.hypot(*(b - a)[:2]) for a, b in pairwise(solved)]
    np.testing.assert_allclose(lengths, 1.02, atol=0.012)
    turns = [float(se2.wrap(b[2] - a[2])) for a, b in pairwise(solved)]
    np.testing.assert_allclose(turns, math.pi / 2, atol=math.radians(0.3))
