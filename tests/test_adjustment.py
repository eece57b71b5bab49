"""Joint adjustment: its equations against dense ones, and poses, wheels and noise against exact truth."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mfslam import se2
from mfslam.adjustment import Noise, ScanPoints, WheelTerms, adjust
from mfslam.adjustment.equations import Equations, Solver
from mfslam.adjustment.noise import Residuals, far_off_m
from mfslam.adjustment.wall_equations import disagreement_weights
from mfslam.adjustment.walls import Walls
from mfslam.config import Config, OdometryConfig
from mfslam.deskew import deskew
from mfslam.kernels import wall_patches, wall_terms
from mfslam.types import Edge, Scan
from mfslam.wheel_errors import WheelStep
from tests.rooms import ROOM, ROOM_PILLARS, laser, moving_scan

NOISE = Noise(0.01, 0.003)
TWIST = np.array([0.6, 0.0, 0.5])
NO_WHEELS = WheelTerms([], np.zeros(3), np.ones(3), OdometryConfig())


def drive(count: int = 24, sigma_m: float = 0.0, seed: int = 0, dt_s: float = 0.3):
    """Deskewed scans of a robot on an arc through the room, and its true poses."""
    model = laser(n_beams=360, turn_s=0.08)
    truth = se2.compose(np.array([-1.5, -0.8, 0.0]), se2.exp(dt_s * np.arange(count)[:, None] * TWIST))
    rng = np.random.default_rng(seed)
    clouds = []
    for pose in truth:
        scan = moving_scan(ROOM, ROOM_PILLARS, pose, TWIST, model)
        noisy = scan.ranges_m + rng.normal(0.0, sigma_m, scan.ranges_m.shape).astype(np.float32)
        clouds.append(deskew(Scan(scan.stamp_ns, noisy, model), TWIST, Config().deskew, 0.02))
    return clouds, truth


def bent(truth, sigmas, seed=1):
    steps = np.random.default_rng(seed).normal(0.0, sigmas, (len(truth) - 1, 3))
    errors = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    return se2.compose(truth, se2.exp(errors))


def run(clouds, start, wheels=NO_WHEELS, edges=(), noise=NOISE, gate_m=0.3):
    spare_m = [np.full(360, np.inf, np.float32)] * len(clouds)
    points = ScanPoints.of(clouds, sum(len(c.points_m) for c in clouds), np.zeros((len(start), 2)), spare_m)
    return adjust(points, start, list(edges), wheels, noise, 10, gate_m)


def test_keyframes_that_drifted_come_back_to_the_truth():
    clouds, truth = drive()
    start = bent(truth, [0.02, 0.02, 0.006])
    before = np.abs(se2.between(truth, start)).max(axis=0)
    after = np.abs(se2.between(truth, run(clouds, start).world_T_body)).max(axis=0)
    assert before[0] > 0.1 and before[2] > 0.01
    assert np.all(after < [0.004, 0.004, 0.002])


def test_noise_is_averaged_over_all_scans_of_a_wall():
    clouds, truth = drive(sigma_m=0.02)
    result = run(clouds, truth, noise=Noise(0.02, 0.003))
    error = se2.between(truth, result.world_T_body)
    # one pair of scans with 2 cm of noise on some 200 beams a wall is good to 2 or 3 mm
    assert np.sqrt(np.mean(error[:, :2] ** 2)) < 0.004
    assert np.sqrt(np.mean(error[:, 2] ** 2)) < 0.002


def test_noise_is_found_whatever_was_told():
    clouds, truth = drive(sigma_m=0.02, seed=3)
    for told_m in (0.01, 0.04):
        found = run(clouds, truth, noise=Noise(told_m, 0.005)).noise
        # scatter within 25 cm of a wall; corners that are no line add a little
        assert 0.015 < found.range_sigma_m < 0.024
        assert found.patch_sigma_m < 0.006


def test_the_first_keyframe_stays():
    clouds, truth = drive(6)
    result = run(clouds, bent(truth, [0.02, 0.02, 0.01]))
    np.testing.assert_allclose(result.world_T_body[0], truth[0], atol=1e-6)


def test_a_keyframe_without_points_is_held_by_its_edges():
    clouds, truth = drive(6)
    clouds[3] = deskew(
        Scan(0, np.full(360, np.nan, np.float32), laser(n_beams=360)), TWIST, Config().deskew, 0.02
    )
    edges = [Edge("scan", k, k + 1, se2.between(truth[k], truth[k + 1]), 25.0 * np.eye(3)) for k in range(5)]
    result = run(clouds, bent(truth, [0.02, 0.02, 0.01]), edges=edges)
    assert np.all(np.abs(se2.between(truth, result.world_T_body)) < [0.01, 0.01, 0.005])


def steps_of(truth, scale=0.0, turn_scale=0.0, sigma=(0.0, 0.0, 0.0), seed=0):
    """Steps as wheels with these errors tell them."""
    rng = np.random.default_rng(seed)
    out = []
    for k in range(len(truth) - 1):
        moved = se2.log(se2.between(truth[k], truth[k + 1]))
        moved = moved / [1.0 + scale, 1.0, 1.0 + turn_scale] + rng.normal(0.0, sigma)
        out.append((k, k + 1, WheelStep(se2.exp(moved), np.zeros(3), np.eye(3))))
    return out


def test_wheel_errors_are_found_with_the_poses():
    clouds, truth = drive(40)
    wheels = WheelTerms(steps_of(truth, 0.04, -0.05), np.zeros(3), np.ones(3), OdometryConfig())
    run(clouds, truth, wheels)
    scale, turn_scale, drift = wheels.errors[0]
    # 7 m of driving, and iterations end when the poses have settled
    assert scale == pytest.approx(0.04, abs=0.008)
    # on a steady arc a turn that is too large and a drift look the same
    assert turn_scale * TWIST[2] + drift * TWIST[0] == pytest.approx(-0.05 * TWIST[2], abs=0.008)


def test_wheels_are_believed_as_far_as_they_deserve():
    clouds, truth = drive(60)
    config = OdometryConfig()
    shares = []
    for sigma in ((0.001, 0.001, 0.001), (0.03, 0.02, 0.03)):
        wheels = WheelTerms(steps_of(truth, sigma=sigma), np.zeros(3), np.ones(3), config)
        run(clouds, truth, wheels)
        shares.append(wheels.share)
    assert np.all(shares[0] < 0.1) and np.all(shares[1] > 10.0 * shares[0])


def test_wheels_that_shall_not_learn_keep_their_noise():
    clouds, truth = drive(40)
    config = OdometryConfig(learn_errors=False)
    wheels = WheelTerms(steps_of(truth), np.zeros(3), np.full(3, 0.7), config)
    run(clouds, truth, wheels)
    np.testing.assert_array_equal(wheels.share, 0.7)


def test_jumps_of_the_wheels_take_no_part():
    _, truth = drive(5)
    steps = steps_of(truth)
    i, j, jump = steps[2]
    steps[2] = (i, j, WheelStep(jump.told, jump.matched, jump.information, jumped=True))
    wheels = WheelTerms(steps, np.zeros(3), np.ones(3), OdometryConfig())
    assert list(wheels.i) == [0, 1, 3]


def test_pose_equations_are_the_schur_complement():
    rng = np.random.default_rng(5)
    scans, walls, groups = 4, 3, 9
    pairs = sorted({(int(rng.integers(scans)), int(rng.integers(walls))) for _ in range(4 * groups)})
    scan_of, patch_of = np.array(pairs, dtype=np.int64).T
    sums = np.zeros((len(pairs), wall_patches.SUMS))
    full, rhs = np.zeros((3 * scans + 2 * walls,) * 2), np.zeros(3 * scans + 2 * walls)
    for g, (k, q) in enumerate(pairs):
        of_pose, of_line = rng.normal(size=(6, 3)), np.stack([-np.ones(6), rng.normal(size=6)], axis=1)
        residual = rng.normal(size=6)
        at = np.concatenate([3 * k + np.arange(3), 3 * scans + 2 * q + np.arange(2)])
        jacobian = np.hstack([of_pose, of_line])
        block = jacobian.T @ jacobian
        full[np.ix_(at, at)] += block
        rhs[at] -= jacobian.T @ residual
        sums[g, :6] = block[np.triu_indices(3)]
        sums[g, 6:9], sums[g, 9:12] = block[:3, 3], block[:3, 4]
        sums[g, 12:15] = block[3, 3], block[3, 4], block[4, 4]
        sums[g, 15:18], sums[g, 18:20] = -of_pose.T @ residual, -of_line.T @ residual
    scan_of, patch_of = np.ascontiguousarray(scan_of, np.int32), np.ascontiguousarray(patch_of, np.int32)
    terms, own, found = np.zeros((walls, 7)), np.zeros((scans, 3, 3)), np.zeros((scans, 3))
    columns = np.empty((len(pairs), 3, 2), np.float32)
    wall_terms.add_line_terms(patch_of, sums, terms)
    roots, weights = wall_terms.line_roots(terms), np.ones(walls)
    wall_terms.eliminate_lines(roots, weights, scan_of, patch_of, sums, own, columns, found)
    poses, lines = slice(0, 3 * scans), slice(3 * scans, None)
    schur = full[poses, lines] @ np.linalg.inv(full[lines, lines])
    expected = full[poses, poses] - schur @ full[lines, poses]
    terms = Walls(own, columns, scan_of, patch_of, walls)
    scale = np.abs(expected).max()  # columns are of single precision
    np.testing.assert_allclose(terms.blocks().whole().toarray(), expected, atol=1e-6 * scale)
    np.testing.assert_allclose(found.ravel(), rhs[poses] - schur @ rhs[lines], atol=1e-9)
    vectors, product = rng.normal(size=(3 * scans, 5)), np.zeros((3 * scans, 5))
    terms.add_product(vectors, product)
    np.testing.assert_allclose(product, expected @ vectors, atol=1e-5 * scale)


@settings(max_examples=25, deadline=None)
@given(st.integers(1, 30), st.integers(1, 12), st.integers(1, 5), st.integers(0, 1000))
def test_walls_on_two_levels_are_their_blocks_on_two_levels(scans, walls, size, seed):
    rng = np.random.default_rng(seed)
    seen = rng.random((scans, walls)) < 0.3
    seen[0, 0] = True
    scan_of, patch_of = (np.ascontiguousarray(at, np.int32) for at in np.nonzero(seen))
    terms = Walls(
        np.tile(100.0 * np.eye(3), (scans, 1, 1)),
        rng.normal(size=(len(scan_of), 3, 2)).astype(np.float32),
        scan_of,
        patch_of,
        walls,
    )
    carried, coarse_of = rng.normal(size=(scans, 3, 3)), np.arange(scans) // size
    within = np.zeros((2, -(-scans // size), 3 * size, 3 * size))
    found = terms.add_stretches(size, carried, coarse_of, within[0])
    expected = terms.blocks().add_stretches(size, carried, coarse_of, within[1])
    np.testing.assert_allclose(found.whole().toarray(), expected.whole().toarray(), atol=1e-9)
    np.testing.assert_allclose(within[0], within[1], atol=1e-9)


@settings(max_examples=25, deadline=None)
@given(st.integers(2, 40), st.integers(0, 2), st.integers(0, 1000))
def test_the_solver_solves_what_a_dense_one_does(count, others, seed):
    rng = np.random.default_rng(seed)
    poses = np.cumsum(rng.normal(0.0, 0.3, (count, 3)), axis=0)
    unknowns = count + others
    equations = Equations(unknowns)
    equations.hold(0)
    for a in range(unknowns - 1):
        at = np.array([a, a + 1]), np.array([int(rng.integers(unknowns)), a])
        jacobians = rng.normal(size=(2, 3, 3)), rng.normal(size=(2, 3, 3))
        equations.add(
            [(at[0], jacobians[0]), (at[1], jacobians[1])],
            rng.normal(size=(2, 3)),
            np.tile(np.eye(3), (2, 1, 1)),
        )
    still = np.tile(np.eye(3), (unknowns, 1, 1))
    equations.add([(np.arange(unknowns), still)], np.zeros((unknowns, 3)), still)
    matrix = equations.matrix()
    solver = Solver(poses, others)
    solver.take([matrix])
    rhs = np.stack([equations.rhs.ravel(), rng.normal(size=3 * unknowns), np.zeros(3 * unknowns)], axis=1)
    exact = np.linalg.solve(matrix.whole().toarray(), rhs)
    np.testing.assert_allclose(solver.solve(rhs, 1e-9), exact, atol=1e-5 * max(1.0, np.abs(exact).max()))


@pytest.mark.parametrize(("limit_m", "counted"), [(4.05, 0), (4.3, 50)])
def test_a_wall_at_the_limit_of_a_range_says_nothing(limit_m, counted):
    """Wherever noise has put its single beams: leaving out the long ones alone would bring it nearer."""
    rng = np.random.default_rng(3)
    across = np.linspace(-0.1, 0.1, 50)
    ranges = np.hypot(4.0, across) + rng.uniform(-0.05, 0.05, 50)
    bearings = np.arctan2(across, 4.0)
    points = ranges[:, None] * np.stack([np.cos(bearings), np.sin(bearings)], axis=1)
    normals = np.tile([-1.0, 0.0], (50, 1))
    wall = np.array([[4.0, 0.0, 1.0, 0.0, 1e-4]])
    _, _, sums = wall_patches.group_sums(
        points, np.zeros((1, 2)), (limit_m - ranges).astype(np.float32), normals, np.array([0, 50]),
        np.zeros((1, 3)), np.zeros(50, np.int32), wall, 0.02, 0.0, 1e3,
    )  # fmt: skip
    assert sums[:, 20].sum() == pytest.approx(counted, rel=1e-6)


def groups(patch_of, mean_m, size):
    sums = np.zeros((len(patch_of), 4), np.float32)
    sums[:, 0], sums[:, 1] = size, np.asarray(mean_m) * size
    return Residuals(np.asarray(patch_of, dtype=np.int32), sums, 2)


def test_how_far_off_scans_are_is_told_by_patches_that_several_saw():
    seen_by_many, seen_by_two = [0] * 100, [1] * 2
    mean_m = np.concatenate([np.linspace(-0.05, 0.05, 100), [0.0, 3.0]])
    assert far_off_m(groups(seen_by_many + seen_by_two, mean_m, 10.0)) == pytest.approx(0.0485, abs=5e-4)
    assert far_off_m(groups(seen_by_two, [0.0, 3.0], 10.0)) == 0.0
    assert far_off_m(groups(seen_by_many, mean_m[:100], 1.0)) == 0.0, "single points are their own noise"


def test_patches_on_which_scans_disagree_weigh_less():
    """Of what moves, each scan is sure of another place."""
    rng, scans, walls = np.random.default_rng(0), 40, 30
    off = rng.normal(size=(scans, walls))
    off[:, 0] *= 10.0
    sums = np.zeros((scans * walls, wall_patches.SUMS))
    sums[:, 12], sums[:, 18] = 1.0, off.ravel()
    patch_of = np.tile(np.arange(walls, dtype=np.int32), scans)
    terms = np.zeros((walls, 7))
    wall_terms.add_line_terms(patch_of, sums, terms)
    weights = disagreement_weights(terms)
    assert weights[0] < 0.01
    assert np.all(weights[1:] > 0.9)
    np.testing.assert_array_equal(disagreement_weights(np.zeros((3, 7))), 1.0)
