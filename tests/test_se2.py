"""SE(2): closed forms, group laws, and the conventions of gtsam.Pose2."""

import math

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mfslam import se2

angles = st.floats(-20.0, 20.0)
coordinates = st.floats(-1e3, 1e3)
poses = st.tuples(coordinates, coordinates, st.floats(-math.pi, math.pi)).map(np.array)
twists = st.tuples(st.floats(-10.0, 10.0), st.floats(-10.0, 10.0), st.floats(-3.1, 3.1)).map(np.array)
tiny_twists = st.tuples(st.floats(-10.0, 10.0), st.floats(-10.0, 10.0), st.floats(-1e-4, 1e-4)).map(np.array)


def assert_same_pose(a, b, atol=1e-9):
    np.testing.assert_allclose(a[..., :2], b[..., :2], rtol=0.0, atol=atol)
    np.testing.assert_allclose(se2.wrap(a[..., 2] - b[..., 2]), 0.0, atol=atol)


def as_array(pose: gtsam.Pose2) -> np.ndarray:
    return np.array([pose.x(), pose.y(), pose.theta()])


def test_storage_order_is_x_y_theta_and_motion_is_in_the_body_frame():
    """One metre ahead of a body at (1, 2) that looks along +y is (1, 3): fails for any swapped order."""
    np.testing.assert_allclose(
        se2.compose(np.array([1.0, 2.0, math.pi / 2]), np.array([1.0, 0.0, 0.1])),
        [1.0, 3.0, math.pi / 2 + 0.1],
        atol=1e-15,
    )


def test_quarter_turn_arc_ends_where_the_circle_says():
    """Speed pi/2 and yaw rate pi/2 for 1 s: a quarter of a circle of radius 1, to the left."""
    np.testing.assert_allclose(
        se2.exp(np.array([math.pi / 2, 0.0, math.pi / 2])), [1.0, 1.0, math.pi / 2], atol=1e-15
    )


@pytest.mark.parametrize("turn", [0.0, 1e-12, 1e-7, 9.9e-7, 1.01e-6, 1e-5, 1e-3])
def test_slow_turns_follow_the_series_through_the_switch(turn):
    """Near zero turn the arc of length 1 is (1 - w^2/6, w/2) to high order."""
    np.testing.assert_allclose(
        se2.exp(np.array([1.0, 0.0, turn])),
        [1.0 - turn**2 / 6.0 + turn**4 / 120.0, turn / 2.0 - turn**3 / 24.0, turn],
        rtol=0.0,
        atol=2e-15,
    )


@given(angles)
def test_wrap_is_the_same_angle_on_one_turn(angle):
    wrapped = float(se2.wrap(angle))
    assert -math.pi <= wrapped <= math.pi
    assert math.isclose(math.cos(wrapped), math.cos(angle), abs_tol=1e-12)
    assert math.isclose(math.sin(wrapped), math.sin(angle), abs_tol=1e-12)


def test_wrap_puts_the_half_turn_at_plus_pi():
    assert float(se2.wrap(math.pi)) == math.pi
    assert float(se2.wrap(-math.pi)) == math.pi


@given(poses, poses, poses)
def test_group_laws(a, b, c):
    assert_same_pose(se2.compose(se2.compose(a, b), c), se2.compose(a, se2.compose(b, c)), 1e-8)
    assert_same_pose(se2.compose(a, se2.inverse(a)), np.zeros(3), 1e-9)
    assert_same_pose(se2.between(a, b), se2.compose(se2.inverse(a), b), 1e-8)
    assert_same_pose(se2.compose(a, se2.between(a, b)), b, 1e-8)


@given(poses, poses)
def test_group_agrees_with_gtsam(a, b):
    ga, gb = gtsam.Pose2(*a), gtsam.Pose2(*b)
    assert_same_pose(se2.compose(a, b), as_array(ga.compose(gb)), 1e-8)
    assert_same_pose(se2.between(a, b), as_array(ga.between(gb)), 1e-8)
    assert_same_pose(se2.inverse(a), as_array(ga.inverse()), 1e-8)
    np.testing.assert_allclose(se2.adjoint(a), ga.AdjointMap(), atol=1e-9)


@given(twists)
def test_exponential_agrees_with_gtsam(xi):
    """Tangent order (vx, vy, omega), as gtsam's; both ways."""
    # gtsam takes the chord for the arc in turns below 1e-9
    assert_same_pose(se2.exp(xi), as_array(gtsam.Pose2.Expmap(xi)), 1e-8)
    np.testing.assert_allclose(se2.log(se2.exp(xi)), gtsam.Pose2.Logmap(gtsam.Pose2.Expmap(xi)), atol=1e-7)


@given(st.one_of(twists, tiny_twists))
def test_log_inverts_exp(xi):
    np.testing.assert_allclose(se2.log(se2.exp(xi)), xi, rtol=0.0, atol=1e-11)


@given(poses, twists)
def test_perturbation_is_on_the_right(pose, xi):
    """exp(Ad xi) T = T exp(xi), and retract of gtsam is T exp(xi)."""
    right = se2.compose(pose, se2.exp(xi))
    left = se2.compose(se2.exp(se2.adjoint(pose) @ xi), pose)
    assert_same_pose(left, right, 1e-7)
    assert_same_pose(right, as_array(gtsam.Pose2(*pose).retract(xi)), 1e-8)


@given(poses, twists, st.floats(0.0, 1.0))
def test_interpolation_holds_one_twist(a, xi, fraction):
    b = se2.compose(a, se2.exp(xi))
    assert_same_pose(se2.interpolate(a, b, fraction), se2.compose(a, se2.exp(fraction * xi)), 1e-8)


def test_interpolation_takes_the_short_way_over_the_half_turn():
    a, b = np.array([0.0, 0.0, 3.0]), np.array([0.0, 0.0, -3.0])
    middle = se2.interpolate(a, b, 0.5)
    assert abs(abs(middle[2]) - math.pi) < 1e-12
    quarter = se2.interpolate(a, b, 0.25)[2]
    assert abs(quarter - (3.0 + 0.25 * (2 * math.pi - 6.0))) < 1e-12


@settings(max_examples=30)
@given(poses, poses)
def test_transform_moves_points_as_compose_moves_origins(a, b):
    point = se2.transform(a, b[None, :2])[0]
    np.testing.assert_allclose(point, se2.compose(a, b)[:2], atol=1e-9)


def test_shapes_broadcast():
    rng = np.random.default_rng(0)
    many, one = rng.normal(size=(4, 5, 3)), rng.normal(size=3)
    assert se2.compose(many, one).shape == (4, 5, 3)
    assert se2.between(one, many).shape == (4, 5, 3)
    assert se2.interpolate(one, many[0, 0], np.linspace(0, 1, 7)).shape == (7, 3)
    assert se2.adjoint(many).shape == (4, 5, 3, 3)
    points = rng.normal(size=(4, 5, 6, 2))
    moved = se2.transform(many, points)
    assert moved.shape == (4, 5, 6, 2)
    np.testing.assert_allclose(moved[2, 3], se2.transform(many[2, 3], points[2, 3]))
