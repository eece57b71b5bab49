"""Information matrices as gtsam must understand them: singular and rotated ones included."""

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from factors import noise_from_information, robust_noise

DECADES = st.floats(-3.0, 6.0)


def rotation(seed):
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return q * np.sign(np.diag(r))


def linear_solve(models, a, b):
    """Weighted least squares of two measurements (3,) of one vector, each with its noise model."""
    graph, origin = gtsam.NonlinearFactorGraph(), gtsam.Values()
    origin.insert(0, np.zeros(3))
    for model, z in zip(models, (a, b), strict=True):
        graph.add(gtsam.PriorFactorPoint3(0, z, model))
    return graph.linearize(origin).optimize().at(0)


@settings(max_examples=150, deadline=None, derandomize=True)
@given(st.integers(0, 10**6), st.tuples(DECADES, DECADES, DECADES), st.integers(0, 2))
def test_solve_equals_weighted_least_squares(seed, decades, singular):
    """A rotated information with 0 to 2 zero eigenvalues, blended with a full one: the closed form."""
    turn = rotation(seed)
    values = 10.0 ** np.array(decades)
    values[:singular] = 0.0
    information = turn @ np.diag(values) @ turn.T
    rng = np.random.default_rng(seed + 1)
    other, z, z_other = np.diag(10.0 ** rng.uniform(0.0, 3.0, 3)), rng.normal(size=3), rng.normal(size=3)
    models = noise_from_information(information), noise_from_information(other)
    expected = np.linalg.solve(information + other, information @ z + other @ z_other)
    # the floor of 1e-9 of the largest eigenvalue stands for nothing
    loss = 10.0 * max(1e-6, 1e-9 * values.max()) / np.diag(other).min() * np.abs(z - z_other).max()
    np.testing.assert_allclose(linear_solve(models, z, z_other), expected, rtol=0.0, atol=1e-9 + 10.0 * loss)


@settings(max_examples=100, deadline=None, derandomize=True)
@given(st.integers(0, 10**6), st.tuples(DECADES, DECADES, DECADES), st.integers(0, 3))
def test_a_weak_direction_stays_weak(seed, decades, singular):
    turn = rotation(seed)
    values = 10.0 ** np.array(decades)
    values[:singular] = 0.0
    information = turn @ np.diag(values) @ turn.T
    kept = noise_from_information(information).information()
    floor = max(1e-6, 1e-9 * float(values.max()))
    np.testing.assert_allclose(kept, information, rtol=1e-6, atol=1.01 * floor + 1e-9 * values.max())
    for k in range(singular):
        assert turn[:, k] @ kept @ turn[:, k] < 2.0 * floor + 1e-9 * values.max()


def test_an_open_direction_is_left_to_others():
    """Nothing is known along (1, 1): the other measurement decides there, and half and half across."""
    half = np.sqrt(0.5)
    turn = np.array([[half, -half, 0.0], [half, half, 0.0], [0.0, 0.0, 1.0]])
    information = turn @ np.diag([0.0, 1.0, 1.0]) @ turn.T
    models = noise_from_information(information), noise_from_information(np.eye(3))
    along, across = turn[:, 0], turn[:, 1]
    blended = linear_solve(models, 5.0 * along + 4.0 * across, np.zeros(3))
    np.testing.assert_allclose(blended, 2.0 * across, atol=1e-4)


@pytest.mark.parametrize(
    "bad",
    [
        np.diag([1.0, -1.0, 1.0]),
        np.diag([1.0, np.nan, 1.0]),
        np.diag([np.inf, 1.0, 1.0]),
        np.eye(2),
        np.ones(3),
    ],
)
def test_what_is_no_information_matrix_is_refused(bad):
    with pytest.raises(ValueError, match="information"):
        noise_from_information(bad)


def test_rounding_below_zero_is_forgiven():
    kept = noise_from_information(np.diag([1e4, 1e4, -1e-9])).information()
    assert 0.0 < kept[2, 2] < 1e-4


@pytest.mark.parametrize(
    ("kernel", "weight"),
    [
        ("huber", lambda e: min(1.0, 2.0 / e)),
        ("cauchy", lambda e: 4.0 / (4.0 + e * e)),
        ("geman-mcclure", lambda e: (4.0 / (4.0 + e * e)) ** 2),
    ],
)
def test_robust_kernels_weigh_by_sigmas(kernel, weight):
    """The square root of the weight multiplies the whitened row."""
    noise = robust_noise(gtsam.noiseModel.Isotropic.Sigma(3, 0.1), kernel, 2.0)
    origin = gtsam.Values()
    origin.insert(0, np.zeros(3))
    for off_m in (0.01, 0.19, 0.5, 5.0):
        factor = gtsam.PriorFactorPoint3(0, np.array([off_m, 0.0, 0.0]), noise)
        row, _ = factor.linearize(origin).jacobian()
        np.testing.assert_allclose(row, np.eye(3) * np.sqrt(weight(off_m / 0.1)) / 0.1, atol=1e-12)
