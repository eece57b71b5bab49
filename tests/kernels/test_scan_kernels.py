"""Projection, normals and thinning of one scan, against closed forms."""

import math

import numpy as np
import pytest
import rooms
from hypothesis import given, settings
from hypothesis import strategies as st

from mfslam import se2
from mfslam.kernels import poses, scans

ANGLES = np.linspace(-2.0, 2.0, 91)
TIMES = np.linspace(-0.03, 0.07, 91)
rates = st.floats(-5.0, 5.0)
turns = st.one_of(st.floats(-7.0, 7.0), st.floats(-1e-6, 1e-6), st.just(0.0))


@settings(max_examples=60, deadline=None, derandomize=True)
@given(rates, rates, turns, rates, rates, st.floats(-3.0, 3.0))
def test_every_beam_starts_from_the_pose_at_its_own_instant(vx, vy, w, mx, my, yaw):
    """Eqs. 16-18 with the exact arc and the mount in between, as se2 has them."""
    twist, mount = np.array([vx, vy, w]), np.array([mx, my, yaw])
    ranges = (2.0 + np.sin(3.0 * ANGLES)).astype(np.float32)
    points, beams = scans.project_beams(ranges, rooms.along(ANGLES + yaw), TIMES, mount, twist, 0.1, 10.0)
    start_T_laser = se2.compose(se2.exp(twist * TIMES[:, None]), mount)
    in_laser = ranges[:, None].astype(float) * np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=-1)
    np.testing.assert_array_equal(beams, np.arange(91))
    np.testing.assert_allclose(
        points, se2.transform(start_T_laser, in_laser[:, None, :])[:, 0], rtol=0.0, atol=1e-13
    )


@pytest.mark.parametrize("turn", [1e-8, 1.1e-9, 9e-10, 3e-7, 1e-4, -1e-8])
def test_the_arc_of_a_small_turn_keeps_its_digits(turn):
    x, y, theta = poses.arc(1.0, 0.0, turn)
    assert x == pytest.approx(1.0 - turn * turn / 6.0, rel=1e-15)
    assert y == pytest.approx(0.5 * turn, rel=1e-8)  # the cosine form is wrong in the first digit here
    assert theta == turn


def test_only_ranges_that_say_where_something_is_give_points():
    ranges = np.array([0.05, 0.1, 1.0, np.inf, np.nan, -np.inf, -1.0, 4.0, 3.999], np.float32)
    angles = np.linspace(0.0, 1.0, ranges.size)
    still = np.zeros(3)
    _, beams = scans.project_beams(
        ranges, rooms.along(angles), np.zeros(ranges.size), still, still, 0.0999, 4.0
    )
    assert beams.tolist() == [1, 2, 8]


def normals_of(points: np.ndarray, step: float = 0.01, sigma: float = 0.005) -> np.ndarray:
    return scans.estimate_normals(points, np.arange(len(points)), np.zeros(2), step, sigma)


@pytest.mark.parametrize("bearing", [0.0, 0.7, 2.5, -1.9, math.pi / 2])
def test_normals_of_a_wall_face_the_sensor(bearing):
    """A wall at 2 m, seen under +-45 deg."""
    angles = np.linspace(-0.785, 0.785, 158)
    wall = np.stack([np.full(158, 2.0), 2.0 * np.tan(angles)], axis=-1)
    turned = se2.transform(np.array([0.0, 0.0, bearing]), wall)
    inward = np.tile([-math.cos(bearing), -math.sin(bearing)], (158, 1))
    np.testing.assert_allclose(normals_of(turned), inward, atol=1e-9)


def test_normals_at_a_corner_belong_to_one_wall_or_to_none():
    """Inside a right corner: exact away from it, near it the wall's own or none, never in between."""
    side = np.arange(0.0, 2.0, 0.02)
    walls = np.concatenate(
        [np.stack([np.full(100, 2.0), side], -1), np.stack([2.0 - side, np.full(100, 2.0)], -1)]
    )
    normals = normals_of(walls)
    np.testing.assert_allclose(normals[4:90], np.tile([-1.0, 0.0], (86, 1)), atol=1e-9)
    np.testing.assert_allclose(normals[110:196], np.tile([0.0, -1.0], (86, 1)), atol=1e-9)
    edge = normals[90:110]
    known = edge[np.hypot(edge[:, 0], edge[:, 1]) > 0.0]
    np.testing.assert_allclose(np.hypot(known[:, 0], known[:, 1]), 1.0, atol=1e-12)
    assert np.all(np.abs(known).max(axis=1) > math.cos(math.radians(20.0)))
    assert len(known) < 20, "the corner itself has no normal"


def test_normals_of_a_pillar_are_radial():
    model = rooms.laser(2880)
    ranges = rooms.cast(np.zeros((0, 4)), np.array([[2.0, 0.0, 0.4]]), np.zeros(3), model)
    hit = np.isfinite(ranges)
    points = ranges[hit, None] * np.stack([np.cos(model.angles_rad[hit]), np.sin(model.angles_rad[hit])], -1)
    normals = normals_of(points, float(model.angles_rad[1] - model.angles_rad[0]))
    radial = (points - [2.0, 0.0]) / 0.4
    known = np.hypot(normals[:, 0], normals[:, 1]) > 0.0
    cosine = np.sum(normals * radial, axis=1)[known]
    assert known.mean() > 0.9
    assert np.median(cosine) > math.cos(math.radians(2.0))


def test_lone_points_and_clutter_have_no_normal():
    lone = np.array([[1.0, 0.0], [3.0, 0.5], [5.0, 2.0], [2.0, 2.0]])
    assert not normals_of(lone).any()
    bush = 2.0 + np.random.default_rng(3).uniform(-0.1, 0.1, (60, 2))
    assert np.mean(np.hypot(*normals_of(bush).T) == 0.0) > 0.9


@settings(max_examples=40, deadline=None, derandomize=True)
@given(st.integers(0, 10_000), st.floats(0.02, 0.5))
def test_thinned_beams_stand_apart_by_the_spacing(seed, spacing):
    step, range_m = 0.01, 3.0
    beams = np.flatnonzero(np.random.default_rng(seed).random(200) < 0.8)
    angles = beams * step
    points = range_m * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    normals = -points / range_m
    keep = scans.thin_points(points, normals, beams, np.zeros(3), step, spacing)
    assert keep[0]
    arcs = np.diff(beams[keep]) * step * range_m
    # each beam that is due is taken at once: one gap between sensed beams late at most
    assert arcs.mean() <= max(spacing, step * range_m) + range_m * step * np.diff(beams).max()
    assert (
        abs(keep.sum() * max(spacing, step * range_m) - np.ptp(angles) * range_m)
        < 0.35 * np.ptp(angles) * range_m
    )


def test_thinning_does_not_prefer_points_that_noise_pushed_along_the_sweep():
    """The mean displacement along the wall of the kept points is that of all points: none."""
    rng = np.random.default_rng(5)
    angles = np.arange(-400, 400) * 0.003
    along = []
    for _ in range(200):
        ranges = 1.0 / np.cos(angles) + rng.normal(0.0, 0.02, angles.size)
        points = ranges[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        normals = np.tile([-1.0, 0.0], (angles.size, 1))
        keep = scans.thin_points(points, normals, np.arange(angles.size), np.zeros(3), 0.003, 0.05)
        along.append(np.mean((points[:, 1] - np.tan(angles))[keep]))
    assert abs(np.mean(along)) < 4.0 * np.std(along) / np.sqrt(len(along))


def test_a_beam_with_a_normal_is_waited_for():
    beams = np.arange(60)
    points = np.stack([np.ones(60), beams * 0.01], axis=-1)
    normals = np.zeros((60, 2))
    normals[7::10] = [-1.0, 0.0]
    keep = scans.thin_points(points, normals, beams, np.zeros(3), 0.01, 0.06)
    assert keep[7::10].sum() >= 3
