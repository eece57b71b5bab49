"""World text: what it says is what stands there; what cannot be understood names its line."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.simulator import load_world, parse_world, random_office, world_names
from drivers.simulator.offices import random_office_text
from drivers.simulator.robot import RobotModel, drive
from drivers.simulator.world import World
from mfslam.types import MfslamError


def clearance_m(world: World, points: np.ndarray) -> float:
    """Least distance of the path from anything that stands still."""
    least = math.inf
    for x1, y1, x2, y2 in world.segments:
        e, offset = np.array([x2 - x1, y2 - y1]), points - [x1, y1]
        u = np.clip(offset @ e / (e @ e), 0.0, 1.0)
        least = min(least, float(np.min(np.hypot(*(offset - u[:, None] * e).T))))
    for x, y, r in world.circles:
        least = min(least, float(np.min(np.hypot(points[:, 0] - x, points[:, 1] - y)) - r))
    return least


def test_items_mean_what_they_say():
    world = parse_world(
        """
        wall 0 0 4 0 4 3      # two walls
        box 2 1 1 0.5 90      # stands on its short side
        pillar 1 2 0.25
        door 0 0 0 1 -90 0    # stands open
        start 1 1 180
        path 1 1 0.5
        path 3 1
        pause 2
        path 3 2 1.5
        """
    )
    np.testing.assert_allclose(world.segments[:2], [[0, 0, 4, 0], [4, 0, 4, 3]])
    corners = world.segments[2:6, :2]
    np.testing.assert_allclose(corners.min(axis=0), [1.75, 0.5])
    np.testing.assert_allclose(corners.max(axis=0), [2.25, 1.5])
    np.testing.assert_allclose(world.segments[6], [0, 0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(world.circles, [[1, 2, 0.25]])
    np.testing.assert_allclose(world.start, [1, 1, math.pi])
    np.testing.assert_allclose(world.path_m, [[1, 1], [3, 1], [3, 2]])
    np.testing.assert_allclose(world.speeds_m_s, [0.5, 0.5, 1.5])
    np.testing.assert_allclose(world.pauses_s, [0, 2, 0])
    assert not world.doors


def test_without_a_start_the_robot_looks_along_its_path():
    world = parse_world("wall 0 0 1 0\npath 1 1\npath 1 1\npath 1 3\n")
    np.testing.assert_allclose(world.start, [1, 1, math.pi / 2])


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("wal 0 0 1 1", "did you mean wall?"),
        ("wall 0 0 1", "expected `wall x1 y1 x2 y2"),
        ("wall 0 0 1 1 2", "even count"),
        ("wall 0 0 0 0", "the same"),
        ("wall 0 0 x 1", "expected a number, got 'x'"),
        ("wall 0 0 inf 1", "finite"),
        ("box 0 0 0 1", "width must be more than 0"),
        ("pillar 0 0 -1", "radius must be more than 0"),
        ("pillar 0 0 1 2", "expected `pillar"),
        ("door 0 0 1 0 90 -1", "period"),
        ("door 0 0 0 0 90 3", "same point"),
        ("person 0.2 0 0 0 1 1", "speed must be more than 0"),
        ("person 0.2 1 0 0 1 1 2", "even count"),
        ("person 0.2 1 3 3 3 3", "all the same"),
        ("path 0 0 0", "speed must be at least 0.1 m/s"),
        ("pause 1", "path point above"),
        ("start 0 0 0\nstart 0 0 0", "second start"),
    ],
)
def test_errors_name_file_and_line(line, said):
    number = 3 + line.count("\n")
    with pytest.raises(MfslamError) as caught:
        parse_world(f"# a world\nwall 0 0 9 9\n{line}\n", "my.world")
    assert str(caught.value).startswith(f"my.world:{number}: ")
    assert said in str(caught.value)


def test_a_world_needs_something_in_it():
    with pytest.raises(MfslamError, match="nothing to see"):
        parse_world("path 0 0\npath 1 1\n")


@settings(max_examples=200, deadline=None)
@given(st.text(alphabet="walboxperdthusign0123456789.-+e# \n\tinf\x00é", max_size=80))
def test_any_text_parses_or_ends_in_one_clear_line(text):
    try:
        world = parse_world(text, "w")
    except MfslamError as error:
        assert str(error).startswith("w") and "\n" not in str(error)
    else:
        assert len(world.segments) + len(world.circles) > 0


def test_world_files_by_name_path_and_neither(tmp_path):
    path = tmp_path / "mine.world"
    path.write_text("wall 0 0 1 0\nwrong\n")
    with pytest.raises(MfslamError, match=r"mine\.world:2: "):
        load_world(path)
    with pytest.raises(MfslamError, match="did you mean demo"):
        load_world("demos")
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(MfslamError, match="expected a world text file"):
        load_world(path)


@pytest.mark.parametrize("name", ["square-aisle", "h-aisle", "office", "demo", "corridor", "hall"])
def test_shipped_worlds_are_driven_to_the_end_without_touching_anything(name):
    assert name in world_names()
    world, robot = load_world(name), RobotModel()
    motion = drive(world, robot)
    assert clearance_m(world, motion.world_T_body[::5, :2]) > 0.25
    assert np.hypot(*(motion.world_T_body[-1, :2] - world.path_m[-1])) < 0.3
    for x, y in world.path_m:
        assert np.min(np.hypot(*(motion.world_T_body[:, :2] - [x, y]).T)) < 0.6


@pytest.mark.parametrize("name", ["square-aisle", "demo"])
def test_driving_keeps_every_limit(name):
    world, robot = load_world(name), RobotModel()
    motion = drive(world, robot)
    v, w, dt = motion.twists[:, 0], motion.twists[:, 2], np.diff(motion.times_s)[1:]
    assert np.max(v) <= min(robot.max_speed_m_s, world.speeds_m_s.max()) + 1e-9
    assert np.max(v) > 2.9
    assert np.max(np.abs(w)) <= robot.max_yaw_rate_rad_s + 1e-9
    assert np.max(np.abs(np.diff(v)) / dt) <= robot.acceleration_m_s2 + 1e-6
    assert np.max(np.abs(np.diff(w)) / dt) <= robot.yaw_acceleration_rad_s2 + 1e-6
    assert np.max(np.abs(v * w)) <= 1.15 * robot.lateral_acceleration_m_s2


def test_pauses_stop_the_robot_for_their_time():
    world = parse_world("wall 0 5 1 5\npath 0 0 1\npath 3 0\npause 2.5\npath 6 0\n")
    motion = drive(world, RobotModel())
    x = motion.world_T_body[:-1, 0]
    standing = (np.abs(motion.twists[:, 0]) < 1e-12) & (x > 2.0) & (x < 4.0)
    assert np.sum(standing) * 0.01 == pytest.approx(2.5, abs=0.05)
    assert abs(float(x[standing][0]) - 3.0) < 0.2


def test_a_path_too_short_or_absent_is_told():
    with pytest.raises(MfslamError, match="at least two `path` points"):
        drive(parse_world("wall 0 0 1 0\npath 1 1\n"), RobotModel())


@pytest.mark.parametrize("seed", range(4))
def test_random_offices_can_be_driven(seed):
    assert random_office_text(seed) == random_office_text(seed)
    assert random_office_text(seed) != random_office_text(seed + 1)
    world = random_office(seed, rooms_per_side=3)
    motion = drive(world, RobotModel())
    assert clearance_m(world, motion.world_T_body[::5, :2]) > 0.2
    assert np.hypot(*(motion.world_T_body[-1, :2] - world.path_m[-1])) < 0.3
    assert random_office(seed, 3, laps=2).path_m.shape[0] > 1.8 * world.path_m.shape[0] - 4
