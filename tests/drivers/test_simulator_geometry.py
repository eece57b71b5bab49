"""The simulator in closed form: rays, motion on arcs, and beams that land on the walls."""

import dataclasses
import math
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.simulator import Motion, RobotModel, World, laser_model, load_world, parse_world, simulate
from drivers.simulator.simulate import cast_scans
from mfslam import se2
from mfslam.config import DeskewConfig
from mfslam.deskew import deskew

ROOM = "wall -3 -2 5 -2 5 4 -3 4 -3 -2\n"
STILL = Motion.from_twists([1.0], [[0.0, 0.0, 0.0]])
FAST_TURN = Motion.from_twists([0.35, 0.4, 0.3], [[3.0, 0.0, 2.0], [2.0, 0.0, -1.5], [0.5, 0.0, 0.0]])


def ideal(name: str = "generic", mount=(0.0, 0.0, 0.0)):
    return dataclasses.replace(laser_model(name, mount), noise=False, range_step_m=0.0)


def distance_to_walls(points: np.ndarray, world: World) -> np.ndarray:
    start, along = world.segments[:, :2], world.segments[:, 2:] - world.segments[:, :2]
    offset = points[:, None, :] - start
    u = np.clip(np.sum(offset * along, axis=-1) / np.sum(along**2, axis=-1), 0.0, 1.0)
    gap = np.hypot(*np.moveaxis(offset - u[..., None] * along, -1, 0))
    discs = np.hypot(*np.moveaxis(points[:, None, :] - world.circles[:, :2], -1, 0)) - world.circles[:, 2]
    return np.min(np.concatenate([gap, np.abs(discs)], axis=1), axis=1)


def end_points(ranges: np.ndarray, laser, motion: Motion, beam_times: np.ndarray) -> np.ndarray:
    """Eqs. 17 and 18 by se2 alone: each beam from the pose at ``beam_times``."""
    hit = np.isfinite(ranges)
    angles, reach = laser.angles_rad[hit], ranges[hit]
    rays = np.stack([reach * np.cos(angles), reach * np.sin(angles)], axis=-1)
    world_T_laser = se2.compose(motion.at(beam_times[hit]), laser.body_T_laser)
    return se2.transform(world_T_laser, rays[:, None, :])[:, 0]


def test_ranges_of_a_rectangular_room_are_those_of_trigonometry():
    laser = ideal()
    ranges = cast_scans(parse_world(ROOM), STILL, laser, np.zeros(1))[0]
    c, s = np.cos(laser.laser.angles_rad), np.sin(laser.laser.angles_rad)
    with np.errstate(divide="ignore"):
        to_x = np.abs(np.where(c > 0, 5.0, -3.0) / c)
        to_y = np.abs(np.where(s > 0, 4.0, -2.0) / s)
    np.testing.assert_allclose(ranges, np.minimum(to_x, to_y), rtol=0.0, atol=1e-12)


def test_pillars_are_round():
    laser = ideal()
    ranges = cast_scans(parse_world("pillar 4 0 0.5"), STILL, laser, np.zeros(1))[0]
    a = laser.laser.angles_rad
    inside = 0.25 - (4.0 * np.sin(a)) ** 2
    seen = (inside > 0) & (np.cos(a) > 0)
    expected = np.where(seen, 4.0 * np.cos(a) - np.sqrt(np.maximum(inside, 0.0)), np.inf)
    np.testing.assert_allclose(ranges, expected, rtol=0.0, atol=1e-12)


def test_glass_is_seen_only_from_ahead():
    laser = ideal()
    ranges = cast_scans(parse_world("glass 2 -9 2 9\nwall 6 -19 6 19"), STILL, laser, np.zeros(1))[0]
    a = laser.laser.angles_rad
    ahead = np.abs(a) < math.radians(14.9)
    beside = (np.abs(a) > math.radians(15.1)) & (np.abs(a) < math.radians(60.0))
    np.testing.assert_allclose(ranges[ahead], 2.0 / np.cos(a[ahead]), atol=1e-12)
    np.testing.assert_allclose(ranges[beside], 6.0 / np.cos(a[beside]), atol=1e-12)


@pytest.mark.parametrize("name", ["urg-04lx", "sick-lms291", "rplidar-a2", "utm-30lx", "fast"])
def test_deskew_with_the_true_motion_puts_every_beam_on_a_wall(name):
    """At 3 m/s and 2 rad/s: to 1e-9 m from exact ranges, and to float32 from the Scan."""
    laser = ideal(name, (0.2, -0.05, 0.3))
    world = parse_world(ROOM + "pillar 3 2.5 0.3\nbox 0 3 1 0.5 20\n")
    times = laser.laser.offsets_s + 0.3
    exact = cast_scans(world, FAST_TURN, laser, np.array([0.3]))[0]
    assert np.mean(np.isfinite(exact)) > 0.4
    points = end_points(exact, laser.laser, FAST_TURN, times)
    assert np.max(distance_to_walls(points, world)) < 1e-9
    run = simulate(world, RobotModel(odometry="none"), laser, motion=FAST_TURN)
    for scan, instant in zip(run.scans, run.instants_s, strict=True):
        ranges = scan.ranges_m.astype(np.float64)
        points = end_points(ranges, scan.laser, FAST_TURN, instant + scan.laser.offsets_s)
        assert np.max(distance_to_walls(points, world)) < 1e-6


@pytest.mark.parametrize("name", ["urg-04lx", "sick-lms291", "rplidar-a2", "fast"])
def test_the_engine_s_deskew_puts_simulated_scans_on_the_walls(name):
    """Scan and true twist in, points on the true walls out: the engine and the simulator agree."""
    laser = ideal(name, (0.2, -0.05, 0.3))
    world = parse_world(ROOM + "box 0 3 1 0.5 20\n")
    twist = np.array([2.5, 0.0, -1.8])
    motion = Motion.from_twists([0.9], [twist], [-1.0, 0.0, 1.0])
    run = simulate(world, RobotModel(odometry="none"), laser, motion=motion)
    for scan in run.scans:
        moved = deskew(scan, twist, DeskewConfig())
        assert len(moved.points_m) > 100
        world_T_body = run.truth_at(np.array(moved.reference_ns))
        points = se2.transform(world_T_body, moved.points_m)
        assert np.max(distance_to_walls(points, world)) < 1e-6


def test_a_snapshot_would_be_wrong_by_decimetres():
    """The same beams, all placed from the pose of the first one: what deskewing is for."""
    laser = ideal("fast")
    world = parse_world(ROOM)
    exact = cast_scans(world, FAST_TURN, laser, np.array([0.0]))[0]
    points = end_points(exact, laser.laser, FAST_TURN, np.zeros_like(laser.laser.offsets_s))
    assert np.mean(distance_to_walls(points, world)) > 0.1


def test_moving_things_are_where_they_are_at_each_beam():
    world = parse_world("wall -50 -50 -50 -49\nperson 0.2 1.5 4 -3 4 3\ndoor -3 -1 -3 1 90 4\n")
    laser = ideal("generic")
    person, door = world.people[0], world.doors[0]
    times = 2.0 + laser.laser.offsets_s
    ranges = cast_scans(world, STILL, laser, np.array([2.0]))[0]
    points = end_points(ranges, laser.laser, STILL, times)
    hit_times = times[np.isfinite(ranges)]
    gap_person = np.abs(np.hypot(*(points - person.at(hit_times)[:, :2]).T) - 0.2)
    leaf = door.at(hit_times)
    e = leaf[:, 2:] - leaf[:, :2]
    gap_door = np.abs(e[:, 0] * (points - leaf[:, :2])[:, 1] - e[:, 1] * (points - leaf[:, :2])[:, 0]) / 2.0
    assert np.max(np.minimum(gap_person, gap_door)) < 1e-9
    assert np.sum(gap_person < 1e-9) > 3 and np.sum(gap_door < 1e-9) > 3


def test_doors_and_people_move_as_written():
    world = parse_world("wall 0 0 1 0\ndoor 0 0 1 0 90 4\nperson 0.2 0.5 0 0 2 0 2 1\n")
    np.testing.assert_allclose(
        world.doors[0].at(np.array([0.0, 2.0, 4.0])),
        [[0, 0, 1, 0], [0, 0, 0, 1], [0, 0, 1, 0]],
        atol=1e-12,
    )
    np.testing.assert_allclose(
        world.people[0].at(np.array([0.0, 2.0, 4.0, 6.0, 8.0, 12.0])),
        [[0, 0, 0.2], [1, 0, 0.2], [2, 0, 0.2], [2, 1, 0.2], [2, 0, 0.2], [0, 0, 0.2]],
        atol=1e-12,
    )


def test_motion_on_a_circle_is_exact():
    """1 m/s at 0.5 rad/s from the origin: a circle of radius 2 about (0, 2)."""
    motion = Motion.from_twists(np.full(400, 0.05), np.tile([1.0, 0.0, 0.5], (400, 1)))
    times = np.linspace(0.0, 20.0, 1234)
    truth = np.stack(
        [2.0 * np.sin(0.5 * times), 2.0 - 2.0 * np.cos(0.5 * times), se2.wrap(0.5 * times)], axis=-1
    )
    np.testing.assert_allclose(motion.at(times), truth, rtol=0.0, atol=1e-12)
    assert motion.distance_m == pytest.approx(20.0, abs=1e-9)


@settings(max_examples=40, deadline=None)
@given(
    st.lists(
        st.tuples(st.floats(0.01, 2.0), st.floats(-3, 3), st.floats(-1, 1), st.floats(-3, 3)),
        min_size=1,
        max_size=8,
    ),
    st.lists(st.floats(-1.0, 20.0), min_size=1, max_size=20),
)
def test_motion_at_any_time_is_the_chain_of_exponentials(pieces, times):
    """In any order of times, outside the knots at rest; against se2 piece by piece."""
    motion = Motion.from_twists([p[0] for p in pieces], [p[1:] for p in pieces], [1.0, -2.0, 3.0])
    for t, pose in zip(times, motion.at(np.array(times)), strict=True):
        expected = np.array([1.0, -2.0, 3.0])
        left = max(t, 0.0)
        for duration, *twist in pieces:
            expected = se2.compose(expected, se2.exp(min(left, duration) * np.array(twist)))
            left = max(left - duration, 0.0)
        np.testing.assert_allclose(pose[:2], expected[:2], atol=1e-9)
        assert abs(float(se2.wrap(pose[2] - expected[2]))) < 1e-9


def test_a_million_beams_per_cpu_second():
    world, laser = load_world("square-aisle"), laser_model("urg-04lx")
    motion = Motion.from_twists([60.0], [[0.3, 0.0, 0.0]], [3.0, 1.2, 0.0])
    cast_scans(world, motion, laser, np.zeros(1))  # compile
    start = time.process_time()
    cast_scans(world, motion, laser, np.arange(0.0, 45.0, 0.1))
    beams = 450 * 682
    assert beams / (time.process_time() - start) > 1e6


def by_brute_force(world: World, poses: np.ndarray, bearings: np.ndarray, range_max: float) -> np.ndarray:
    """Ranges of standing things, every beam against every one of them, no grid."""
    o = poses[..., None, :2]
    heading = (poses[..., 2] + bearings)[..., None]
    dx, dy = np.cos(heading), np.sin(heading)
    e = world.segments[:, 2:] - world.segments[:, :2]
    w = world.segments[:, :2] - o
    with np.errstate(divide="ignore", invalid="ignore"):
        cross = dx * e[:, 1] - dy * e[:, 0]
        t = (w[..., 0] * e[:, 1] - w[..., 1] * e[:, 0]) / cross
        u = (w[..., 0] * dy - w[..., 1] * dx) / cross
    t = np.where((t > 0.0) & (u >= -1e-12) & (u <= 1.0 + 1e-12), t, np.inf)
    c = world.circles[:, :2] - o
    across, along = c[..., 0] * dy - c[..., 1] * dx, c[..., 0] * dx + c[..., 1] * dy
    inside = world.circles[:, 2] ** 2 - across**2
    near = along - np.sqrt(np.maximum(inside, 0.0))
    discs = np.where((inside >= 0.0) & (near > 0.0), near, np.inf)
    best = np.min(np.concatenate([t, discs], axis=-1), axis=-1)
    return np.where(best <= range_max, best, np.inf)


@settings(max_examples=30)
@given(st.integers(0, 2**31), st.sampled_from([0.3, 3.0, 40.0, 4000.0]))
def test_the_grid_changes_no_range(seed, size_m):
    """Worlds of any size, from within, beside and far outside, along the axes and on the cells' borders."""
    rng = np.random.default_rng(seed)
    walls = rng.uniform(-size_m, size_m, (12, 4))
    walls[:4] = np.round(walls[:4] * 2.0) / 2.0  # on borders
    walls[4, 2], walls[5, 3] = walls[4, 0], walls[5, 1]  # along the axes
    lines = ["wall " + " ".join(map(str, w)) for w in walls if tuple(w[:2]) != tuple(w[2:])]
    lines += [f"pillar {x} {y} {r}" for x, y, r in np.abs(rng.uniform(0.01, size_m, (3, 3))) * [1, 1, 0.1]]
    world = parse_world("\n".join(lines))
    laser = ideal("generic")
    laser = dataclasses.replace(laser, laser=dataclasses.replace(laser.laser, range_max_m=2.0 * size_m))
    start = rng.uniform(-1.5 * size_m, 1.5 * size_m, 3)
    if seed % 3 == 0:
        start = np.array([round(start[0]), round(start[1]), 0.0])
    motion = Motion.from_twists([1.0], [[size_m, 0.0, 1.0]], start)
    times = laser.laser.offsets_s[None, :]
    expected = by_brute_force(world, motion.at(times), laser.laser.angles_rad, 2.0 * size_m)
    ranges = cast_scans(world, motion, laser, np.zeros(1))
    np.testing.assert_allclose(ranges, expected, rtol=1e-9, atol=1e-9 * size_m)
