"""Registration as the engine calls it: both methods, their information, and what the prior does."""

from __future__ import annotations

import math

import numpy as np
import pytest
import rooms

from factors import noise_from_information
from mfslam import icp, se2
from mfslam.config import DeskewConfig, IcpConfig
from mfslam.deskew import deskew, reference_offset_s
from mfslam.kernels import cells

LINE = IcpConfig()
POINT = IcpConfig(method="point_to_point", max_iterations=100)
SIGMA_M = 0.01


def table_of(cloud):
    return icp.reference_table(np.hstack(cloud))


@pytest.fixture(scope="module")
def room():
    return table_of(rooms.oriented_points(rooms.ROOM, rooms.ROOM_PILLARS, np.zeros(3), SIGMA_M, seed=1))


@pytest.mark.parametrize(("method", "most_m", "most_deg"), [(LINE, 0.004, 0.1), (POINT, 0.015, 0.4)])
@pytest.mark.parametrize("ref_T_src", [[0.2, -0.1, 0.1], [-0.1, 0.2, -0.15]])
def test_both_methods_converge_on_noisy_scans(room, method, most_m, most_deg, ref_T_src):
    truth = np.array(ref_T_src)
    cloud = rooms.oriented_points(rooms.ROOM, rooms.ROOM_PILLARS, truth, SIGMA_M, seed=2)
    match = icp.register(room, *cloud, np.zeros(3), SIGMA_M, method)
    error = se2.between(truth, match.ref_T_src)
    assert match.converged
    assert math.hypot(error[0], error[1]) < most_m
    assert abs(error[2]) < math.radians(most_deg)
    assert match.inlier_ratio > 0.85
    assert 0.5 * SIGMA_M < match.rms_m < 2.5 * SIGMA_M


def test_the_information_is_an_honest_covariance(room):
    """Over 60 draws of the noise, errors in sigmas stay below 1 rms and none is absurdly sure of itself.

    Independent beams and no systematic error: what is left out of the default noise model here makes the
    stated sigmas larger than the errors, never smaller.
    """
    config = LINE.model_copy(update={"independent_share": 1.0, "sigma_floor_m": 0.0, "sigma_floor_deg": 0.0})
    truth = np.array([0.1, 0.05, 0.05])
    chi2 = []
    for seed in range(60):
        reference = table_of(
            rooms.oriented_points(rooms.ROOM, rooms.ROOM_PILLARS, np.zeros(3), SIGMA_M, seed=2 * seed)
        )
        cloud = rooms.oriented_points(rooms.ROOM, rooms.ROOM_PILLARS, truth, SIGMA_M, seed=2 * seed + 1)
        stated = icp.register(reference, *cloud, truth, SIGMA_M, config)
        error = se2.log(se2.between(truth, stated.ref_T_src))
        honest = icp.register(reference, *cloud, truth, SIGMA_M, LINE)
        chi2.append((error @ stated.information @ error, error @ honest.information @ error))
    model, default = np.mean(chi2, axis=0)
    assert 1.0 < model < 30.0, "3 if all beams were independent; correlated normals make it more"
    assert default < 3.0, "the default share of independent beams and the floor make up for that"


YAW = 0.3  # of the robot to the corridor
ALONG = np.array([math.cos(YAW), -math.sin(YAW), 0.0])  # the corridor's direction in the body frame
ACROSS = np.array([math.sin(YAW), math.cos(YAW), 0.0])


def corridor_table(sigma_m):
    """Recent past in a corridor, as the front end keeps it: several scans, averaged to one surface."""
    merged = []
    for k in range(10):
        world_T_body = np.array([-0.3 * k, 0.02 * k, YAW - 0.02 * k])
        points, normals = rooms.oriented_points(
            rooms.CORRIDOR, rooms.NO_PILLARS, world_T_body, sigma_m, 50 + k
        )
        ref_T_body = se2.compose(se2.inverse(np.array([0.0, 0.0, YAW])), world_T_body)
        turn = np.array([0.0, 0.0, ref_T_body[2]])
        merged.append(np.hstack([se2.transform(ref_T_body, points), se2.transform(turn, normals)]))
    raw = icp.reference_table(np.vstack(merged))
    return icp.reference_table(cells.smooth_surface(raw, icp.CELL_M, 0.1, 0.04))


def corridor_match(method, sigma_m, prior_off):
    """0.3 m along a corridor, guessed as none; the prior is off by ``prior_off`` and sure to 1 cm.

    Returns the error of the match and its information.
    """
    truth = 0.3 * ALONG
    cloud = rooms.oriented_points(
        rooms.CORRIDOR, rooms.NO_PILLARS, np.array([0.3, 0.0, YAW]), sigma_m, seed=4
    )
    prior, firmness = se2.compose(truth, np.array(prior_off)), np.full(3, 0.01)
    match = icp.register(
        corridor_table(sigma_m), *cloud, np.zeros(3), max(sigma_m, 0.005), method, prior, firmness
    )
    return se2.between(truth, match.ref_T_src), match.information


@pytest.mark.parametrize("method", [LINE, POINT])
def test_a_corridor_stays_weak_all_the_way_into_the_graph(method):
    """Also for point-to-point, whose own residuals would call the sliding direction sure."""
    _, information = corridor_match(method, 0.0, [0.0, 0.0, 0.0])
    for kept in (information, noise_from_information(information).information()):
        assert ALONG @ kept @ ALONG < 1e-3 * (ACROSS @ kept @ ACROSS)


@pytest.mark.parametrize("method", [LINE, POINT])
@pytest.mark.parametrize("sigma_m", [0.01, 0.02])
def test_noisy_normals_do_not_make_a_corridor_sure(method, sigma_m):
    """What noise pretends along it is less than a tenth of what a wheel step of 0.3 m tells (2 cm)."""
    _, information = corridor_match(method, sigma_m, [0.0, 0.0, 0.0])
    assert ALONG @ information @ ALONG < 0.1 * 0.02**-2
    assert ACROSS @ information @ ACROSS > 0.01**-2


@pytest.mark.parametrize("method", [LINE, POINT])
def test_the_prior_decides_along_the_corridor_and_not_across(method):
    error, _ = corridor_match(method, 0.01, 0.02 * ACROSS)
    assert abs(ALONG @ error) < 0.02, "the prior's; the guess was 0.3 m off"
    assert abs(ACROSS @ error) < 0.008, "the scans'"


def test_floor_of_a_regular_information_is_the_sum_of_covariances():
    information = np.array([[900.0, 30.0, 5.0], [30.0, 400.0, -8.0], [5.0, -8.0, 5e4]])
    floored = icp.with_floor(information, 0.01, 0.002)
    expected = np.linalg.inv(np.linalg.inv(information) + np.diag([1e-4, 1e-4, 4e-6]))
    np.testing.assert_allclose(floored, expected, rtol=1e-9)


def test_floor_keeps_a_singular_direction_singular():
    open_direction = np.array([math.cos(0.4), math.sin(0.4), 0.0])
    closed = np.array([-math.sin(0.4), math.cos(0.4), 0.0])
    information = 1e6 * np.outer(closed, closed) + np.diag([0.0, 0.0, 1e8])
    floored = icp.with_floor(information, 0.004, 0.002)
    np.testing.assert_allclose(floored @ open_direction, 0.0, atol=1e-6)
    assert closed @ floored @ closed == pytest.approx(1.0 / (1e-6 + 0.004**2), rel=1e-9)
    np.testing.assert_array_equal(floored, floored.T)
    np.testing.assert_array_equal(icp.with_floor(np.zeros((3, 3)), 0.004, 0.002), np.zeros((3, 3)))


def test_without_partners_nothing_is_claimed(room):
    far = np.array([[100.0, 0.0], [100.0, 1.0], [101.0, 0.0]])
    for method in (LINE, POINT):
        match = icp.register(room, far, np.zeros((3, 2)), np.zeros(3), SIGMA_M, method)
        assert not match.converged
        assert match.inlier_ratio == 0.0
        assert not match.information.any()
        np.testing.assert_array_equal(match.ref_T_src, np.zeros(3))


def test_empty_clouds_are_no_error(room):
    nothing = np.zeros((0, 2))
    for method in (LINE, POINT):
        for reference in (room, icp.reference_table(np.zeros((0, 4)))):
            match = icp.register(reference, nothing, nothing, np.zeros(3), SIGMA_M, method)
            assert not match.converged


def test_motion_free_beats_conventional_on_a_moving_robot():
    """2 m/s and 1.5 rad/s under a laser of 100 ms per turn: deskewed scans match, snapshots do not."""
    twist, model = np.array([2.0, 0.0, 1.5]), rooms.laser(turn_s=0.1)
    steps = [np.zeros(3), np.array([0.2, 0.01, 0.15])]
    errors = {}
    for mode in ("pose", "none"):
        clouds = [
            deskew(
                rooms.moving_scan(rooms.ROOM, rooms.ROOM_PILLARS, pose, held, model),
                held,
                DeskewConfig(mode=mode),
            )
            for pose, held in zip(steps, (twist, np.zeros(3)), strict=True)
        ]
        reference = icp.reference_table(np.hstack([clouds[0].points_m, clouds[0].normals]))
        match = icp.register(reference, clouds[1].points_m, clouds[1].normals, steps[1], SIGMA_M, LINE)
        # the moving scan's points stand where the robot was in its middle, the other's at its stamp
        to_middle = se2.exp(reference_offset_s(model) * twist)
        errors[mode] = se2.between(se2.between(to_middle, steps[1]), match.ref_T_src)
    assert np.hypot(*errors["pose"][:2]) < 0.002
    assert np.hypot(*errors["none"][:2]) > 0.01
