"""Deskew: a ray-cast room under a known twist comes back exactly; the paper's scalar variant where it may."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
import rooms

from mfslam import se2
from mfslam.config import DeskewConfig
from mfslam.deskew import beam_times_s, deskew, reference_offset_s
from mfslam.types import Scan

POSE, RANGE, NONE = (DeskewConfig(mode=mode) for mode in ("pose", "range", "none"))
FAST_TURN = np.array([3.0, 0.0, 2.0])
START = np.array([-0.5, 0.3, 0.4])
WALL = np.array([[5.0, -200.0, 5.0, 200.0]])


def room_scan(twist, model):
    """A scan of the room by a robot that is at START at the stamp."""
    return rooms.moving_scan(rooms.ROOM, rooms.ROOM_PILLARS, START, twist, model)


def distance_to_room(points_m, segments=rooms.ROOM, pillars=rooms.ROOM_PILLARS):
    """Distance of points (M, 2) in the world to the nearest wall or pillar."""
    a, e = segments[:, :2], segments[:, 2:] - segments[:, :2]
    u = np.clip(np.sum((points_m[:, None] - a) * e, -1) / np.sum(e * e, -1), 0.0, 1.0)
    to_walls = np.linalg.norm(points_m[:, None] - a - u[..., None] * e, axis=-1)
    to_pillars = np.abs(np.linalg.norm(points_m[:, None] - pillars[:, :2], axis=-1) - pillars[:, 2])
    return np.minimum(to_walls.min(axis=1, initial=np.inf), to_pillars.min(axis=1, initial=np.inf))


def error_m(scan, twist, config, world_T_stamp=START):
    """Largest distance of a deskewed point to the room it was cast in."""
    cloud = deskew(scan, twist, config)
    since_stamp_s = (cloud.reference_ns - scan.stamp_ns) * 1e-9
    world_T_reference = se2.compose(world_T_stamp, se2.exp(twist * since_stamp_s))
    return float(distance_to_room(se2.transform(world_T_reference, cloud.points_m)).max())


@pytest.mark.parametrize(
    "twist", [[3.0, 0.0, 0.0], [0.0, 0.0, 3.0], [2.0, 0.5, -2.0], [-1.0, 0.0, 0.3], [0.0, 0.0, 0.0]]
)
def test_pose_mode_recovers_the_room(twist):
    """To the rounding of float32 ranges: 8 m x 2^-24."""
    motion = np.array(twist)
    scan = room_scan(motion, rooms.laser(turn_s=0.1))
    assert error_m(scan, motion, POSE) < 1e-6


def test_pose_mode_is_exact_to_a_nanometre_beside_float32():
    """Points against the true ones, from ranges that float32 holds exactly."""
    model = rooms.laser(turn_s=0.1)
    ranges = (np.arange(720) % 64 + 8) / 16.0
    scan = Scan(0, ranges.astype(np.float32), dataclasses.replace(model, range_max_m=80.0))
    cloud = deskew(scan, FAST_TURN, POSE)
    poses = se2.exp(FAST_TURN * beam_times_s(model)[:, None])
    local = ranges[:, None] * np.stack([np.cos(model.angles_rad), np.sin(model.angles_rad)], axis=-1)
    np.testing.assert_allclose(cloud.points_m, se2.transform(poses, local[:, None])[:, 0], atol=1e-12)


def test_a_snapshot_of_a_moving_robot_is_wrong_by_what_it_drove():
    """At 3 m/s and 0.1 s a turn both ends of the conventional scan are 0.15 m off against its middle."""
    ahead = np.array([3.0, 0.0, 0.0])
    scan = room_scan(ahead, rooms.laser(turn_s=0.1))
    assert 0.1 < error_m(scan, ahead, NONE) < 0.155


def test_turning_in_place():
    turn = np.array([0.0, 0.0, 4.0])
    scan = room_scan(turn, rooms.laser(turn_s=0.1))
    assert error_m(scan, turn, POSE) < 1e-6
    assert error_m(scan, turn, NONE) > 0.3
    np.testing.assert_array_equal(deskew(scan, turn, RANGE).points_m, deskew(scan, turn, NONE).points_m)


def test_the_papers_range_correction_is_exact_straight_ahead_only():
    """Eqs. 19-24: along the direction of travel it is exact, abeam it makes a good range wrong."""
    ahead = np.array([2.0, 0.0, 0.0])
    model = rooms.laser(turn_s=0.1)
    narrow = dataclasses.replace(model, angles_rad=np.zeros(720))
    scan = rooms.moving_scan(WALL, rooms.NO_PILLARS, np.zeros(3), ahead, narrow)
    driven_m = 2.0 * reference_offset_s(narrow)  # until the middle of the scan
    np.testing.assert_allclose(deskew(scan, ahead, RANGE).points_m[:, 0], 5.0 - driven_m, atol=1e-6)
    abeam = dataclasses.replace(model, angles_rad=np.full(720, math.pi / 2))
    wall = np.array([[-50.0, 3.0, 50.0, 3.0]])
    scan = rooms.moving_scan(wall, rooms.NO_PILLARS, np.zeros(3), ahead, abeam)
    assert np.ptp(deskew(scan, ahead, RANGE).points_m[:, 1]) == pytest.approx(0.2, abs=1e-6)
    np.testing.assert_allclose(deskew(scan, ahead, POSE).points_m[:, 1], 3.0, atol=1e-6)


def test_the_variants_rank_as_they_should_in_a_room():
    motion = np.array([3.0, 0.0, 0.0])
    scan = room_scan(motion, rooms.laser(turn_s=0.1))
    errors = [error_m(scan, motion, config) for config in (POSE, RANGE, NONE)]
    assert errors[0] < 1e-6 < errors[1]
    assert errors[0] < 1e-6 < errors[2]


@pytest.mark.parametrize("mount", [[0.145, 0.0, 0.0], [-0.2, 0.1, 3.0], [0.0, 0.0, math.pi]])
def test_the_mount_comes_in_between(mount):
    model = dataclasses.replace(rooms.laser(turn_s=0.1), body_T_laser=np.array(mount))
    scan = room_scan(FAST_TURN, model)
    assert error_m(scan, FAST_TURN, POSE) < 1e-6


@pytest.mark.parametrize(
    ("first_s", "last_s", "expected_s"),
    [
        (0.0, 0.1, 0.05),  # stamped at the first beam
        (-0.05, 0.05, 0.0),  # at the middle one
        (-0.1, 0.0, -0.05),  # at the last
        (-0.15, -0.083, -0.1165),  # older than its stamp
        (0.02, 0.12, 0.07),  # younger
        (0.1, 0.0, 0.05),  # sensed against the order of its beams
    ],
)
def test_the_reference_is_the_middle_of_the_scan_whatever_beam_is_stamped(first_s, last_s, expected_s):
    model = dataclasses.replace(rooms.laser(), offsets_s=np.linspace(first_s, last_s, 720))
    assert reference_offset_s(model) == pytest.approx(expected_s, abs=1e-12)
    scan = room_scan(FAST_TURN, model)
    assert deskew(scan, FAST_TURN, POSE).reference_ns == scan.stamp_ns + round(expected_s * 1e9)
    assert error_m(scan, FAST_TURN, POSE) < 1e-6


def test_a_wrong_transport_delay_shows():
    """Beams 0.15 s older than believed, in a turn: the room is wrong although deskewed."""
    model = rooms.laser(turn_s=0.1)
    late = dataclasses.replace(model, offsets_s=model.offsets_s - 0.15)
    scan = room_scan(FAST_TURN, late)
    believed = Scan(scan.stamp_ns, scan.ranges_m, model)
    assert error_m(scan, FAST_TURN, POSE) < 1e-6
    assert error_m(believed, FAST_TURN, POSE) > 0.1


def test_beams_are_the_raw_scans_and_thinning_keeps_them_apart():
    model = rooms.laser(turn_s=0.1)
    scan = room_scan(FAST_TURN, model)
    scan.ranges_m[10:20] = np.nan
    scan.ranges_m[100:110] = np.inf
    full = deskew(scan, FAST_TURN, POSE)
    hidden = set(range(10, 20)) | set(range(100, 110))
    assert full.beams.tolist() == [b for b in range(720) if b not in hidden]
    thin = deskew(scan, FAST_TURN, POSE, spacing_m=0.2)
    rows = np.searchsorted(full.beams, thin.beams)
    np.testing.assert_array_equal(thin.points_m, full.points_m[rows])
    np.testing.assert_array_equal(thin.normals, full.normals[rows])
    gaps_m = np.hypot(*np.diff(thin.points_m, axis=0).T)
    # counted by angle and range: a waited-for point may stand nearer to the next, a slanted wall spreads them
    assert np.median(gaps_m) >= 0.2
    assert np.percentile(gaps_m, 10) >= 0.5 * 0.2


def test_a_scan_without_any_return_is_empty():
    model = rooms.laser(turn_s=0.1)
    cloud = deskew(Scan(5, np.full(720, np.inf, np.float32), model), FAST_TURN, POSE, 0.05)
    assert cloud.points_m.shape == (0, 2)
    assert cloud.normals.shape == (0, 2)
    one = dataclasses.replace(model, angles_rad=np.zeros(1), offsets_s=np.zeros(1))
    assert deskew(Scan(5, np.array([2.0], np.float32), one), FAST_TURN, POSE).points_m.tolist() == [
        [2.0, 0.0]
    ]


def test_a_turn_that_grows_through_the_scan_is_followed_exactly():
    """Twist in the middle of the scan and its change per second: beam t is seen from heading w0 t + a t^2 / 2."""
    model = dataclasses.replace(rooms.laser(turn_s=0.1), body_T_laser=np.zeros(3))
    ranges = (np.arange(len(model.angles_rad)) % 64 + 8) / 16.0
    times = beam_times_s(model)
    rate, change = -1.0, 4.0  # in the middle of the scan
    motion = np.array([0.0, 0.0, rate, 0.0, 0.0, change])
    cloud = deskew(Scan(0, ranges.astype(np.float32), model), motion, POSE)
    bearings = (model.angles_rad + rate * times + 0.5 * change * times**2)[cloud.beams]
    expected = ranges[cloud.beams, None] * np.stack([np.cos(bearings), np.sin(bearings)], axis=1)
    np.testing.assert_allclose(cloud.points_m, expected, atol=1e-9)


def facing_share(segments, world_T_laser, sigma_m, bearing_deg=(-180.0, 180.0)):
    """Share of the beams within some bearings that get a normal, if a doubtful one, and these normals."""
    model = dataclasses.replace(rooms.laser(n_beams=720), range_sigma_m=sigma_m)
    scan = rooms.moving_scan(segments, np.zeros((0, 3)), np.array(world_T_laser), np.zeros(3), model)
    noise_m = np.random.default_rng(0).normal(0.0, sigma_m, scan.ranges_m.shape)
    noisy = Scan(0, (scan.ranges_m + noise_m).astype(np.float32), model)
    cloud = deskew(noisy, np.zeros(3), POSE, doubtful=True)
    low, high = np.radians(bearing_deg)
    bearings = model.angles_rad[cloud.beams]
    normals = cloud.normals[(low <= bearings) & (bearings <= high)]
    return float(np.mean(normals.any(axis=1))), normals[normals.any(axis=1)]


def test_a_wall_has_normals_whatever_the_noise():
    share, normals = facing_share(WALL, [2.0, 0.0, 0.0], 0.02, (-45.0, 45.0))
    assert share > 0.9
    assert np.median(np.abs(np.arctan2(normals[:, 1], -normals[:, 0]))) < 0.08


def test_a_wall_seen_at_a_slant_has_normals():
    """Neighbouring beams meet it half a metre apart."""
    share, normals = facing_share(np.array([[-20.0, 1.0, 20.0, 1.0]]), [0.0, 0.0, 0.0], 0.005, (8.0, 16.0))
    assert share > 0.9
    assert np.abs(np.arctan2(normals[:, 0], -normals[:, 1])).max() < 0.1


def test_a_post_before_a_wall_lends_it_no_normals():
    """Beams past an edge jump from one surface to the other: no line between the two."""
    walls = np.array([[5.0, -5.0, 5.0, 5.0], [2.0, 0.0, 2.0, 5.0]])
    _, normals = facing_share(walls, [0.0, 0.0, 0.0], 0.005, (-20.0, 20.0))
    assert np.abs(np.arctan2(normals[:, 1], -normals[:, 0])).max() < 0.3
