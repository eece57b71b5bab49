"""Covariances of adjusted poses on two levels, against the inverse of the whole."""

from __future__ import annotations

import numpy as np
import pytest

from mfslam import se2
from mfslam.adjustment import AdjustedInformation
from mfslam.adjustment.equations import Equations, Solver
from mfslam.adjustment.wheels import between_jacobians
from mfslam.deskew import acceleration_lever_s2
from tests.rooms import laser

COUNT, OWN = 40, np.diag([1e4, 1e4, 1e5])


def adjusted() -> tuple[np.ndarray, Solver, np.ndarray]:
    """Poses along a bend, each tied to the next five as scans are that share walls, and one error of the wheels."""
    poses = se2.exp(np.arange(COUNT)[:, None] * np.array([0.3, 0.0, 0.05]))
    pairs = np.array([(i, j) for j in range(COUNT) for i in range(max(0, j - 5), j)])
    i, j = pairs.T
    equations = Equations(COUNT + 1)
    before, after = between_jacobians(se2.between(poses[i], poses[j]))
    equations.add([(i, before), (j, after)], np.zeros((len(i), 3)), np.tile(OWN, (len(i), 1, 1)))
    equations.add([(np.array([COUNT]), np.eye(3)[None])], np.zeros((1, 3)), np.eye(3)[None])
    equations.hold(0)
    solver = Solver(poses, 1)
    solver.take([equations.matrix()])
    return poses, solver, np.linalg.inv(equations.matrix().whole().toarray())


def test_two_levels_are_near_the_whole():
    poses, solver, inverse = adjusted()
    information = AdjustedInformation(poses, solver, 1.0)
    covariances = information.marginals()
    assert not covariances[0].any()
    exact = np.array([inverse[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] for k in range(COUNT)])
    sigmas, exact_sigmas = (np.sqrt(np.diagonal(c[6:], axis1=1, axis2=2)) for c in (covariances, exact))
    np.testing.assert_allclose(sigmas, exact_sigmas, rtol=0.25)
    i, j = np.array([3, 10]), np.array([30, 38])
    for a, b, found in zip(i, j, information.relative_covariances(i, j), strict=True):
        jacobian = np.zeros((3, len(inverse)))
        jacobian[:, 3 * b : 3 * b + 3] = np.eye(3)
        jacobian[:, 3 * a : 3 * a + 3] = -se2.adjoint(se2.between(poses[b], poses[a]))
        expected = jacobian @ inverse @ jacobian.T
        np.testing.assert_allclose(np.sqrt(np.diag(found)), np.sqrt(np.diag(expected)), rtol=0.25)


def test_smoothed_poses_are_as_sure_as_they_are_then():
    poses, solver, _ = adjusted()
    information = AdjustedInformation(poses, solver, 1.0)
    plain, before = information.marginals(), information.single_variances
    information.take_smoothed(before + np.array([4e-6, 1e-6, 2e-6]))
    added = np.diagonal(information.marginals() - plain, axis1=1, axis2=2)
    assert np.all(
        added[1:] > np.array([4e-6, 1e-6, 2e-6])
    )  # as much at the pose, and that of the first, seen from it
    np.testing.assert_allclose(added[1, [0, 2]], [8e-6, 4e-6], rtol=0.1)
    information.take_smoothed(before)
    np.testing.assert_allclose(information.marginals(), plain, rtol=1e-9, atol=1e-15)
    less_sure = AdjustedInformation(poses, solver, 2.0).marginals()
    np.testing.assert_allclose(less_sure, 2.0 * plain, rtol=1e-6)


@pytest.mark.parametrize("first_s", [0.0, -0.05])
def test_an_acceleration_acts_by_a_24th_of_the_duration_squared(first_s):
    model = laser(n_beams=2000, turn_s=0.1)
    model.offsets_s[:] += first_s
    assert acceleration_lever_s2(model) == pytest.approx(0.1**2 / 24.0, rel=1e-2)
