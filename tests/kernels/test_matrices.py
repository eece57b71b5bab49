"""Information matrices in compiled code, against numpy."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mfslam.kernels import matrices


def information_of(seed, open_directions=0):
    """Random symmetric matrix over nine decades, with so many directions left open."""
    rng = np.random.default_rng(seed)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    values = 10.0 ** rng.uniform(-2.0, 7.0, 3)
    values[:open_directions] = 0.0
    return turn @ np.diag(values) @ turn.T, turn


@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.integers(0, 10**6), st.floats(1e-6, 1e-2), st.floats(1e-6, 1e-2))
def test_an_error_adds_to_the_covariance(seed, var_xy, var_turn):
    information, _ = information_of(seed)
    expected = np.linalg.inv(np.linalg.inv(information) + np.diag([var_xy, var_xy, var_turn]))
    got = matrices.add_error(information, var_xy, var_turn)
    scale = np.linalg.norm(expected)
    np.testing.assert_allclose(got, expected, rtol=1e-5, atol=1e-7 * scale)
    np.testing.assert_array_equal(got, got.T)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.integers(0, 10**6), st.integers(1, 3))
def test_open_directions_stay_open(seed, count):
    information, turn = information_of(seed, count)
    got = matrices.add_error(information, 1e-4, 1e-5)
    for k in range(count):
        assert abs(turn[:, k] @ got @ turn[:, k]) < 1e-9 * max(1.0, np.linalg.norm(information))
    assert np.linalg.eigvalsh(got)[0] > -1e-9 * max(1.0, np.linalg.norm(information))


@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.integers(0, 10**6), st.integers(0, 3))
def test_root_is_upper_triangular_and_squares_to_the_floored_matrix(seed, count):
    information, _ = information_of(seed, count)
    root = matrices.upper_root(information, 1e-6, 1e-9)
    floor = max(1e-6, 1e-9 * np.trace(information))
    assert np.all(np.tril(root, -1) == 0.0)
    assert np.all(np.diag(root) > 0.0)
    np.testing.assert_allclose(
        root.T @ root,
        information + floor * np.eye(3),
        rtol=1e-9,
        atol=1e-9 * floor + 1e-12 * np.trace(information),
    )


@pytest.mark.parametrize("bad", [np.diag([1.0, -1.0, 1.0]), np.full((3, 3), np.nan), -np.eye(3)])
def test_what_has_no_root_gives_no_number(bad):
    assert np.isnan(np.diag(matrices.upper_root(bad, 1e-6, 1e-9))).any()
