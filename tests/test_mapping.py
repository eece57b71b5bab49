"""The map in closed form: a room of which every beam is known, people, turning, far and missing returns."""

import numpy as np
import pytest

from mfslam import mapping, se2
from mfslam.config import Config
from mfslam.deskew import deskew, reference_offset_s
from mfslam.mapping import cells
from mfslam.metrics import crispness
from mfslam.settings import load
from mfslam.types import Findings, Laser, MfslamError, Scan

ROOM = (-3.013, -2.021, 4.987, 3.979)  # x_min, y_min, x_max, y_max
STILL = np.zeros(3)


def make_laser(beams=361, fov_deg=270.0, period_s=0.0, sigma_m=0.01, mount=(0.1, 0.0, 0.0), range_max_m=30.0):
    angles = np.radians(np.linspace(-fov_deg / 2, fov_deg / 2, beams))
    offsets = (angles - angles[0]) / (2.0 * np.pi) * period_s
    return Laser("ideal", angles, offsets, 0.05, range_max_m, sigma_m, np.array(mount))


def cast(laser: Laser, pose, twist=STILL, person=None, rng=None) -> np.ndarray:
    """Ranges in the room, every beam from the pose at its own instant; ``person`` (x, y, radius) in the way."""
    times = laser.offsets_s - reference_offset_s(laser)
    at = se2.compose(se2.compose(pose, se2.exp(twist * times[:, None])), laser.body_T_laser)
    c, s = np.cos(at[:, 2] + laser.angles_rad), np.sin(at[:, 2] + laser.angles_rad)
    with np.errstate(divide="ignore"):
        to_x = np.abs((np.where(c > 0, ROOM[2], ROOM[0]) - at[:, 0]) / c)
        to_y = np.abs((np.where(s > 0, ROOM[3], ROOM[1]) - at[:, 1]) / s)
    ranges = np.fmin(to_x, to_y)
    if person is not None:
        dx, dy = person[0] - at[:, 0], person[1] - at[:, 1]
        along, across = dx * c + dy * s, dx * s - dy * c
        to_person = along - np.sqrt(np.maximum(person[2] ** 2 - across**2, 0.0))
        ranges = np.where((np.abs(across) < person[2]) & (along > 0), np.minimum(ranges, to_person), ranges)
    if rng is not None:
        ranges = ranges + rng.normal(0.0, laser.range_sigma_m, len(ranges))
    return ranges.astype(np.float32)


def drive_round(laser: Laser, n=60, person=None, noise=True, seed=1):
    """Scans from a loop through the room, and their poses."""
    rng = np.random.default_rng(seed)
    phase = np.linspace(0.0, 2.0 * np.pi, n)
    poses = np.stack([1.0 + 1.9 * np.cos(phase), 1.0 + 1.2 * np.sin(phase), 3.0 * phase], axis=-1)
    poses[:, 2] = se2.wrap(poses[:, 2])
    people = person or (lambda k: None)
    scans = [
        Scan(k * 100_000_000, cast(laser, poses[k], person=people(k), rng=rng if noise else None), laser)
        for k in range(n)
    ]
    return scans, poses


def render(scans, poses, twists=None, config=None):
    twists = np.zeros((len(scans), 3)) if twists is None else twists
    return mapping.render_map(scans, poses, twists, config or Config())


def centres(grid, value):
    rows, cols = np.nonzero(grid.occupancy == value)
    return grid.origin_m + grid.resolution_m * (np.stack([cols, rows], axis=-1) + 0.5)


def off_walls(points):
    """Signed distance to the nearest wall of the room: negative inside."""
    return np.max(
        [ROOM[0] - points[:, 0], points[:, 0] - ROOM[2], ROOM[1] - points[:, 1], points[:, 1] - ROOM[3]],
        axis=0,
    )


@pytest.mark.parametrize("resolution_m", [0.05, 0.02])
def test_room_walls_are_one_cell_free_up_to_them_and_unknown_beyond(resolution_m):
    scans, poses = drive_round(make_laser())
    grid, _ = render(scans, poses, config=load([], [f"map.resolution_m={resolution_m}"]))
    walls = centres(grid, 100)
    off = off_walls(walls)
    # half a cell, and what noise of one cm adds to the choice of the cell
    assert np.max(np.abs(off)) <= 0.5 * resolution_m + 0.02
    assert np.mean(np.abs(off) <= 0.5 * resolution_m + 0.005) > 0.95
    length_m = 2.0 * (ROOM[2] - ROOM[0] + ROOM[3] - ROOM[1])
    assert len(walls) == pytest.approx(length_m / resolution_m, rel=0.05), "one cell thick, no gaps"
    free = centres(grid, 0)
    assert np.max(off_walls(free)) <= 0.5 * resolution_m
    area_m2 = (ROOM[2] - ROOM[0]) * (ROOM[3] - ROOM[1])
    known_m2 = resolution_m**2 * (len(free) + 0.5 * len(walls))
    assert known_m2 == pytest.approx(area_m2, rel=0.01), "free space right up to the walls"
    assert np.all(grid.occupancy[0] == -1) and np.all(grid.occupancy[:, 0] == -1)


def test_walls_are_closed():
    """No way out of the room over free or unknown cells, neither straight nor diagonal between wall cells."""
    from scipy import ndimage

    grid, _ = render(*drive_round(make_laser()))
    labels, _ = ndimage.label(grid.occupancy != 100)  # 4-connected: diagonal wall cells close
    inside = np.floor((np.array([1.0, 1.0]) - grid.origin_m) / grid.resolution_m).astype(int)
    assert labels[inside[1], inside[0]] != labels[0, 0]


def test_a_wall_along_the_grid_is_exact_without_noise():
    scans, poses = drive_round(make_laser(), noise=False)
    grid, cloud = render(scans, poses)
    assert np.max(np.abs(off_walls(centres(grid, 100)))) <= 0.5 * grid.resolution_m + 1e-6
    assert np.max(np.abs(off_walls(cloud.points_m))) < 1e-5  # float32 ranges
    assert len(cloud.points_m) == sum(len(scan.ranges_m) for scan in scans)


def test_a_grazing_beam_does_not_wear_a_wall_away():
    """Driving along a wall at 0.4 m: it is met at all angles down to a few degrees, and stays closed."""
    laser = make_laser(beams=721)
    rng = np.random.default_rng(5)
    poses = np.stack([np.linspace(-2.5, 4.5, 150), np.full(150, ROOM[1] + 0.4), np.zeros(150)], axis=-1)
    scans = [Scan(k, cast(laser, pose, rng=rng), laser) for k, pose in enumerate(poses)]
    for resolution_m in (0.05, 0.02):
        grid, _ = render(scans, poses, config=load([], [f"map.resolution_m={resolution_m}"]))
        walls = centres(grid, 100)
        south = walls[(np.abs(walls[:, 1] - ROOM[1]) < 0.1) & (walls[:, 0] > -2.75)]  # farther back is unseen
        columns = np.unique(np.round((south[:, 0] - grid.origin_m[0]) / resolution_m - 0.5))
        assert len(columns) >= 0.99 * (ROOM[2] + 2.75) / resolution_m


def test_a_person_walking_through_leaves_nothing():
    def walks(k):
        return -2.0 + 0.1 * k, -1.0 + 0.05 * k, 0.2

    scans, poses = drive_round(make_laser(), person=walks)
    grid, cloud = render(scans, poses)
    assert np.sum(off_walls(cloud.points_m) < -0.1) > 300, "the person was seen"
    assert np.min(off_walls(centres(grid, 100))) > -0.1, "and is not in the map"


def test_what_stays_is_kept():
    grid, _ = render(*drive_round(make_laser(), person=lambda k: (2.0, -0.8, 0.15)))
    inside = centres(grid, 100)[off_walls(centres(grid, 100)) < -0.1]
    assert len(inside) >= 8
    assert np.max(np.abs(np.hypot(inside[:, 0] - 2.0, inside[:, 1] + 0.8) - 0.15)) < 0.06


@pytest.mark.parametrize("transport_delay_s", [0.0, -0.3, 0.2])
def test_deskew_straightens_what_a_turning_robot_sees(transport_delay_s):
    laser = make_laser(period_s=0.1, sigma_m=0.001)
    laser = Laser(**{**laser.__dict__, "offsets_s": laser.offsets_s + transport_delay_s})
    twist = np.array([0.8, 0.0, 2.0])
    poses = se2.compose(np.array([0.5, 0.0, 0.3]), se2.exp(twist * (0.1 * np.arange(40))[:, None]))
    scans = [Scan(k * 100_000_000, cast(laser, pose, twist), laser) for k, pose in enumerate(poses)]
    twists = np.tile(twist, (40, 1))
    grid, cloud = render(scans, poses, twists)
    skewed_grid, skewed = render(scans, poses, twists, load([], ["deskew.mode=none"]))
    assert np.max(np.abs(off_walls(cloud.points_m))) < 1e-5
    assert np.max(np.abs(off_walls(skewed.points_m))) > 0.2
    assert crispness(cloud.points_m).cells < 0.6 * crispness(skewed.points_m).cells
    assert np.max(np.abs(off_walls(centres(grid, 100)))) < 0.05
    assert np.sum(skewed_grid.occupancy == 100) > np.sum(grid.occupancy == 100)


@pytest.mark.parametrize("mode", ["pose", "range", "none"])
def test_points_are_those_of_deskew(mode):
    """Two ways to the same points: the map's kernel, and deskew followed by se2."""
    laser = make_laser(period_s=0.1, mount=(0.2, -0.1, 0.4))
    config = load([], [f"deskew.mode={mode}"])
    pose, twist = np.array([0.3, 0.2, -1.0]), np.array([1.5, 0.1, -1.2])
    scan = Scan(7_000_000_000, cast(laser, pose, twist), laser)
    _, cloud = render([scan], pose[None], twist[None], config)
    deskewed = deskew(scan, twist, config.deskew)
    np.testing.assert_allclose(cloud.points_m, se2.transform(pose, deskewed.points_m), atol=1e-6)
    expected_ns = 7_000_000_000 + np.round(laser.offsets_s[deskewed.beams] * 1e9).astype(np.int64)
    np.testing.assert_array_equal(cloud.stamps_ns, expected_ns)


def test_beams_without_return():
    laser = make_laser(beams=91, fov_deg=90.0, range_max_m=8.0)
    ranges = np.full(91, np.inf, np.float32)
    ranges[45] = np.nan
    scans, poses = [Scan(0, ranges, laser)] * 3, np.zeros((3, 3))
    silent, cloud = render(scans, poses)
    assert len(cloud.points_m) == 0 and np.all(silent.occupancy == -1)
    grid, _ = render(scans, poses, config=load([], ["map.no_return_free_m=2.0"]))
    free = centres(grid, 0) - laser.body_T_laser[:2]
    assert np.max(np.hypot(*free.T)) <= 2.05 and not np.any(grid.occupancy == 100)
    assert len(free) * 0.05**2 == pytest.approx(np.pi * 2.0**2 / 4.0, rel=0.05)


def test_far_hits_tell_free_space_only():
    laser = make_laser(beams=3, fov_deg=2.0, range_max_m=80.0, mount=(0.0, 0.0, 0.0))
    scans = [Scan(0, np.full(3, 50.0, np.float32), laser)] * 4
    grid, cloud = render(scans, np.zeros((4, 3)), config=load([], ["map.max_range_m=5.0"]))
    assert not np.any(grid.occupancy == 100) and len(cloud.points_m) == 12
    assert centres(grid, 0)[:, 0].max() == pytest.approx(5.0, abs=0.05)


def test_one_hit_in_one_cell():
    laser = make_laser(beams=1, fov_deg=0.0, mount=(0.0, 0.0, 0.0))
    laser = Laser(**{**laser.__dict__, "angles_rad": np.zeros(1)})
    scans = [Scan(k, np.array([1.02], np.float32), laser) for k in range(3)]
    grid, _ = render(scans, np.tile([0.02, 0.01, 0.0], (3, 1)))
    np.testing.assert_allclose(centres(grid, 100), [[1.025, 0.025]])
    np.testing.assert_allclose(centres(grid, 0), [[0.025 + 0.05 * k, 0.025] for k in range(20)])
    grid, _ = render(scans[:1], np.tile([0.02, 0.01, 0.0], (1, 1)))
    assert not np.any(grid.occupancy == 100), "min_hits"


def test_no_scans_give_an_empty_map():
    grid, cloud = render([], np.zeros((0, 3)))
    assert np.all(grid.occupancy == -1) and cloud.points_m.shape == (0, 2)


def test_two_lasers_and_changing_beam_counts():
    front, rear = make_laser(beams=181), make_laser(beams=91, mount=(-0.2, 0.0, np.pi))
    pose = np.array([1.0, 1.0, 0.2])
    scans = [Scan(k, cast(laser, pose), laser) for k, laser in enumerate([front, rear, front, rear, rear])]
    grid, cloud = render(scans, np.tile(pose, (5, 1)))
    assert len(cloud.points_m) == 2 * 181 + 3 * 91
    assert np.max(np.abs(off_walls(centres(grid, 100)))) < 0.05


def test_too_many_cells_is_one_line_that_says_what_would_do():
    laser = make_laser(beams=2)
    poses = np.array([[0.0, 0.0, 0.0], [30_000.0, 20_000.0, 0.0]])
    scans = [Scan(k, np.ones(2, np.float32), laser) for k in range(2)]
    with pytest.raises(
        MfslamError, match=r"map\.resolution_m: .* million cells.* set map\.resolution_m=(\S+)"
    ) as e:
        render(scans, poses)
    assert "\n" not in str(e.value)
    enough = float(str(e.value).split("set map.resolution_m=")[1].split()[0])
    assert 3e4 * 2e4 / enough**2 < cells.MAX_CELLS
    assert 3e4 * 2e4 / enough**2 > 0.7 * cells.MAX_CELLS


def test_same_input_same_bytes():
    scans, poses = drive_round(make_laser())
    (a, a_cloud), (b, b_cloud) = render(scans, poses), render(scans, poses)
    assert a.occupancy.tobytes() == b.occupancy.tobytes()
    assert a_cloud.points_m.tobytes() == b_cloud.points_m.tobytes()


def test_a_cloud_above_its_limit_is_thinned_evenly_and_told():
    scans, poses = drive_round(make_laser())
    _, whole = render(scans, poses)
    findings = Findings()
    config = load([], ["map.max_points=5000"])
    grid, thinned = mapping.render_map(scans, poses, np.zeros((60, 3)), config, findings)
    np.testing.assert_array_equal(thinned.points_m, whole.points_m[::5])
    np.testing.assert_array_equal(thinned.stamps_ns, whole.stamps_ns[::5])
    assert "points-thinned" in findings
    np.testing.assert_array_equal(grid.occupancy, render(scans, poses)[0].occupancy)


def test_poses_that_are_not_finite_never_reach_the_kernels():
    scans, poses = drive_round(make_laser(), n=3)
    poses[1, 0] = np.nan
    with pytest.raises(ValueError, match="not finite"):
        render(scans, poses)


def test_judging_in_bands_changes_nothing(monkeypatch):
    scans, poses = drive_round(make_laser())
    whole, _ = render(scans, poses)
    monkeypatch.setattr(cells, "_BAND_ROWS", 7)
    np.testing.assert_array_equal(render(scans, poses)[0].occupancy, whole.occupancy)


@pytest.mark.parametrize("resolution_m", [0.05, 0.02])
def test_a_wall_of_ten_centimetres_keeps_both_its_faces(resolution_m):
    """A slab across the room's middle, seen from both sides: two lines of cells, and nothing known between."""
    rng, laser = np.random.default_rng(2), make_laser(beams=721, sigma_m=0.02)
    scans, poses = [], []
    for k, (x, y) in enumerate([(-1.5 + 0.05 * k, side) for side in (0.4, 1.6) for k in range(60)]):
        pose = np.array([x, y, 0.4 if y > 1.0 else -2.0])
        ranges = cast(laser, pose)
        at = se2.compose(pose, laser.body_T_laser)
        sine = np.sin(at[2] + laser.angles_rad)
        face = 1.027 if at[1] > 1.0 else 0.927
        with np.errstate(divide="ignore"):
            to_face = (face - at[1]) / sine
        ranges = np.where(to_face > 0.0, np.minimum(ranges, to_face), ranges)
        scans.append(Scan(k, (ranges + rng.normal(0.0, 0.02, 721)).astype(np.float32), laser))
        poses.append(pose)
    grid, _ = render(scans, np.array(poses), config=load([], [f"map.resolution_m={resolution_m}"]))
    columns = ((np.arange(-1.0, 1.5, 0.1) - grid.origin_m[0]) / resolution_m).astype(int)
    rows = ((np.array([0.927, 1.027]) - grid.origin_m[1]) / resolution_m).astype(int)
    across = grid.occupancy[rows[0] - 3 : rows[1] + 4, columns]
    assert np.all(np.sum(across == 100, axis=0) == 2)
    assert np.all(across[:2] == 0) and np.all(across[-2:] == 0)


def pane_scans(laser, poses, pane_y, rng):
    """Scans of the room with a pane of glass across it that only beams within 15 deg of square meet."""
    scans = []
    for k, pose in enumerate(poses):
        at = se2.compose(pose, laser.body_T_laser)
        sine = np.sin(at[2] + laser.angles_rad)
        with np.errstate(divide="ignore"):
            to_pane = (pane_y - at[1]) / sine
        ranges = cast(laser, pose)
        met = (to_pane > 0.0) & (np.abs(sine) > np.cos(np.radians(15.0)))
        ranges = np.where(met, np.minimum(ranges, to_pane), ranges)
        scans.append(Scan(k, (ranges + rng.normal(0.0, 0.01, ranges.shape)).astype(np.float32), laser))
    return scans


def test_glass_seen_through_from_aslant_and_met_squarely_is_a_wall():
    rng, laser = np.random.default_rng(1), make_laser(beams=541)
    x = np.linspace(-1.5, 3.5, 120)
    poses = np.stack([x, np.full(120, 0.3), 0.3 * np.sin(x)], axis=-1)
    grid, _ = render(pane_scans(laser, poses, 1.8, rng), poses)
    inside = centres(grid, 100)[off_walls(centres(grid, 100)) < -0.1]
    assert np.max(np.abs(inside[:, 1] - 1.8)) < 0.06
    columns = np.unique(np.round(inside[:, 0] / grid.resolution_m - 0.5))
    assert len(columns) > 0.9 * 5.0 / grid.resolution_m
    beyond = centres(grid, 0)
    assert np.sum((beyond[:, 1] > 2.0) & (off_walls(beyond) < -0.1)) > 1000, (
        "what is behind is seen through it"
    )


def test_a_person_who_walks_beside_the_robot_is_no_glass():
    """Met squarely at every instant, as glass is, but narrow, and gone when the robot stands still."""

    def beside(k):
        return -1.9 + 0.05 * k, 1.5, 0.2

    rng, laser = np.random.default_rng(4), make_laser(beams=541)
    poses = np.stack([np.linspace(-1.9, 4.0, 119), np.full(119, 0.3), np.zeros(119)], axis=-1)
    scans = [Scan(k, cast(laser, p, person=beside(k), rng=rng), laser) for k, p in enumerate(poses)]
    grid, _ = render(scans, poses)
    walls = centres(grid, 100)
    where = np.abs(walls[:, 0] - 1.0) < 2.0  # at both ends of the log nothing came before or after the person
    assert np.min(off_walls(walls)[where]) > -0.1


def test_slits_between_beams_are_free_and_walls_between_them_closed():
    """Beams 1 deg apart at 6 m, cells of 2 cm: without filling, a comb."""
    laser = make_laser(beams=181, fov_deg=180.0, sigma_m=0.005, mount=(0.0, 0.0, 0.0))
    poses = np.tile([-2.0, 1.0, 0.0], (5, 1))
    scans = [Scan(k, cast(laser, pose), laser) for k, pose in enumerate(poses)]
    grid, _ = render(scans, poses, config=load([], ["map.resolution_m=0.02"]))
    walls = centres(grid, 100)
    east = walls[(np.abs(walls[:, 0] - ROOM[2]) < 0.03) & (np.abs(walls[:, 1] - 1.0) < 2.5)]
    assert len(east) >= 0.95 * 5.0 / 0.02
    rows, cols = np.nonzero(grid.occupancy == -1)
    unknown = grid.origin_m + 0.02 * (np.stack([cols, rows], axis=-1) + 0.5) - poses[0, :2]
    near = (np.hypot(*unknown.T) < 5.0) & (
        np.abs(np.arctan2(unknown[:, 1], unknown[:, 0])) < np.radians(85.0)
    )
    assert not np.any(near & (off_walls(unknown + poses[0, :2]) < -0.1))
