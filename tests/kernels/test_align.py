"""Registration kernels on rooms cast without noise, and the closed form against numpy's SVD."""

import math

import numpy as np
import pytest
import rooms
from hypothesis import given, settings
from hypothesis import strategies as st

from mfslam import se2
from mfslam.kernels import align, cells

CELL_M = 0.25
SIGMA_M = 0.014
FREE = np.zeros((3, 3))


def table_of(points, normals):
    return cells.build_cells(np.hstack([points, normals]), CELL_M)


def to_line(table, points, normals, guess, prior=None, information=FREE, radius=0.5, iterations=40):
    prior = guess if prior is None else prior
    return align.point_to_line(
        table, CELL_M, points, normals, guess, prior, information, SIGMA_M, 3.0, radius, 0.1, iterations
    )


@pytest.fixture(scope="module")
def room():
    return table_of(
        *rooms.oriented_points(rooms.ROOM, rooms.ROOM_PILLARS, np.zeros(3), model=rooms.laser(2880))
    )


@pytest.mark.parametrize(
    "ref_T_src",
    [
        [0.0, 0.0, 0.0],
        [0.3, -0.1, 0.1],
        [-0.2, 0.25, -0.15],
        [0.05, 0.3, 0.2],
        [0.0, 0.0, 0.3],
        [-0.35, 0.0, 0.0],
    ],
)
def test_point_to_line_finds_the_motion_to_a_millimetre(room, ref_T_src):
    truth = np.array(ref_T_src)
    points, normals = rooms.oriented_points(rooms.ROOM, rooms.ROOM_PILLARS, truth)
    pose, information, inliers, rms, iterations, converged = to_line(room, points, normals, np.zeros(3))
    assert converged
    assert iterations < 40
    error = se2.between(truth, pose)
    assert math.hypot(error[0], error[1]) < 1e-3
    assert abs(error[2]) < 5e-4
    assert inliers > 0.9
    assert rms < 0.003
    assert np.linalg.eigvalsh(information)[0] > 1e3


def test_a_corridor_holds_across_and_not_along():
    """Information along the bare walls is nothing beside that across, and the prior decides there."""
    table = table_of(*rooms.oriented_points(rooms.CORRIDOR, rooms.NO_PILLARS, np.zeros(3)))
    truth = np.array([0.4, 0.15, 0.05])
    points, normals = rooms.oriented_points(rooms.CORRIDOR, rooms.NO_PILLARS, truth)
    prior = np.array([0.4, 0.0, 0.0])
    pose, information, *_ = to_line(
        table, points, normals, np.zeros(3), prior, np.diag([100.0, 100.0, 100.0])
    )
    along = np.array([math.cos(truth[2]), -math.sin(truth[2])])  # of the corridor, in the source frame
    across = np.array([math.sin(truth[2]), math.cos(truth[2])])
    blocks = information[:2, :2]
    assert along @ blocks @ along < 1e-3 * (across @ blocks @ across)
    error = se2.between(truth, pose)
    assert abs(pose[0] - 0.4) < 0.01, "the prior places it along the corridor"
    assert abs(pose[1] - 0.15) < 1e-3
    assert abs(error[2]) < 5e-4


def test_a_firm_prior_is_kept_and_a_loose_one_is_not(room):
    truth = np.array([0.2, 0.1, 0.1])
    points, normals = rooms.oriented_points(rooms.ROOM, rooms.ROOM_PILLARS, truth)
    wrong = truth + np.array([0.05, -0.05, 0.02])
    held = to_line(room, points, normals, wrong, wrong, np.diag([1e12, 1e12, 1e12]))[0]
    np.testing.assert_allclose(held, wrong, atol=1e-5)
    freed = to_line(room, points, normals, wrong, wrong, np.diag([1.0, 1.0, 1.0]))[0]
    np.testing.assert_allclose(freed, truth, atol=1e-3)


def test_nothing_in_common_is_no_convergence(room):
    points = np.array([[50.0, 50.0], [51.0, 50.0], [52.0, 50.5]])
    pose, information, inliers, rms, _, converged = to_line(room, points, np.zeros((3, 2)), np.ones(3))
    assert not converged
    assert not information.any()
    assert (inliers, rms) == (0.0, 0.0)
    np.testing.assert_array_equal(pose, np.ones(3))


def svd_fit(d, m):
    """Eqs. 26-39 as the paper writes them, with the determinant guard."""
    c_d, c_m = d.mean(axis=0), m.mean(axis=0)
    u, _, vt = np.linalg.svd((d - c_d).T @ (m - c_m))
    rotation = vt.T @ np.diag([1.0, np.linalg.det(vt.T @ u.T)]) @ u.T
    return rotation, c_m - rotation @ c_d


@settings(max_examples=80, deadline=None, derandomize=True)
@given(st.integers(0, 100_000), st.integers(3, 30), st.floats(0.0, 5.0), st.booleans())
def test_rigid_fit_is_the_svd_solution(seed, count, noise, mirrored):
    """Mirrored partners: where the plain V U^T would be a reflection."""
    rng = np.random.default_rng(seed)
    d = rng.normal(size=(count, 2))
    m = se2.transform(rng.normal(size=3), d * [1.0, -1.0] if mirrored else d) + noise * rng.normal(
        size=(count, 2)
    )
    rotation, translation = svd_fit(d, m)
    pose = align.rigid_fit(d, m)
    c, s = math.cos(pose[2]), math.sin(pose[2])
    centered = (d - d.mean(0)).T @ (m - m.mean(0))
    # where every rotation is as good as any other, compare what both reach
    best = np.trace(rotation @ centered)
    assert np.trace(np.array([[c, -s], [s, c]]) @ centered) == pytest.approx(best, rel=1e-9, abs=1e-9)
    if best > 1e-3 * np.linalg.norm(centered):
        np.testing.assert_allclose([[c, -s], [s, c]], rotation, atol=1e-9)
        np.testing.assert_allclose(pose[:2], translation, atol=1e-8)


def test_rigid_fit_keeps_its_digits_far_from_the_origin():
    d = 1e5 + np.random.default_rng(2).normal(size=(50, 2))
    truth = np.array([3.0, -4.0, 1e-4])
    moved = align.rigid_fit(d, se2.transform(truth, d))
    np.testing.assert_allclose(se2.transform(moved, d), se2.transform(truth, d), atol=1e-8)


@pytest.mark.parametrize("ref_T_src", [[0.1, -0.05, 0.05], [-0.15, 0.1, -0.1], [0.0, 0.0, 0.1]])
def test_point_to_point_comes_near(room, ref_T_src):
    """Points are not the same from elsewhere, so it ends near the truth, not on it."""
    truth = np.array(ref_T_src)
    source = table_of(*rooms.oriented_points(rooms.ROOM, rooms.ROOM_PILLARS, truth))
    pose, iterations, converged = align.point_to_point(room, source, CELL_M, np.zeros(3), 0.5, 0.1, 200, True)
    assert converged
    assert iterations < 200
    error = se2.between(truth, pose)
    assert math.hypot(error[0], error[1]) < 0.01
    assert abs(error[2]) < math.radians(0.3)


def test_point_to_point_partners_are_mutual_or_the_nearest():
    """Two source points near one reference point: only the nearer one is its partner (eq. 25), or both are
    (eq. 3) and draw the scan towards their mean."""
    reference = table_of(np.array([[0.0, 0.0], [1.0, 0.0]]), np.zeros((2, 2)))
    source = table_of(np.array([[0.0, 0.01], [0.0, 0.2], [1.0, 0.01]]), np.zeros((3, 2)))
    mutual, _, converged = align.point_to_point(reference, source, CELL_M, np.zeros(3), 0.5, 0.1, 50, True)
    assert converged
    np.testing.assert_allclose(mutual, [0.0, -0.01, 0.0], atol=1e-9)
    nearest, _, _ = align.point_to_point(reference, source, CELL_M, np.zeros(3), 0.5, 0.5, 50, False)
    partners = reference[1][[0, 0, 1], :2]
    np.testing.assert_allclose(nearest, align.rigid_fit(source[1][:, :2], partners), atol=1e-9)


def test_point_to_point_with_one_pair_says_that_it_failed():
    reference = table_of(np.array([[0.0, 0.0]]), np.zeros((1, 2)))
    pose, _, converged = align.point_to_point(reference, reference, CELL_M, np.zeros(3), 0.5, 0.1, 9, True)
    assert not converged
    np.testing.assert_array_equal(pose, np.zeros(3))
