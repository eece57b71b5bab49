"""Single poses in compiled code do what `mfslam.se2` does for arrays."""

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from mfslam import se2
from mfslam.kernels import poses

pose = st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3), st.floats(-math.pi, math.pi)).map(np.array)
twist = st.tuples(st.floats(-9.0, 9.0), st.floats(-9.0, 9.0), st.floats(-9.0, 9.0)).map(np.array)


def same(a, b):
    np.testing.assert_allclose(a[:2], b[:2], rtol=0.0, atol=1e-9)
    assert abs(float(se2.wrap(a[2] - b[2]))) < 1e-12


@settings(deadline=None, derandomize=True)
@given(pose, pose, twist, st.floats(-3.0, 3.0))
def test_kernels_agree_with_se2(a, b, xi, duration):
    same(poses.compose(a, b), se2.compose(a, b))
    same(poses.between(a, b), se2.between(a, b))
    same(poses.advance(a, xi, duration), se2.compose(a, se2.exp(xi * duration)))
    same(poses.interpolate(a, b, duration), se2.interpolate(a, b, duration))
    np.testing.assert_allclose(poses.log(a), se2.log(a), rtol=1e-12, atol=1e-12)


def test_half_turns_stand_at_plus_pi():
    assert poses.wrap_angle(math.pi) == math.pi
    assert poses.wrap_angle(-math.pi) == math.pi
    assert poses.wrap_angle(3.0 * math.pi) == math.pi


def test_points_and_normals_turn_together():
    rng = np.random.default_rng(1)
    points, normals, out = rng.normal(size=(7, 2)), rng.normal(size=(7, 2)), np.empty((7, 4))
    a_T_b = np.array([3.0, -2.0, 0.8])
    poses.transform_points(a_T_b, points, normals, out)
    np.testing.assert_allclose(out[:, :2], se2.transform(a_T_b, points), atol=1e-14)
    np.testing.assert_allclose(out[:, 2:], se2.transform(np.array([0.0, 0.0, 0.8]), normals), atol=1e-14)
