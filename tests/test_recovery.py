"""Where a robot can be that nobody watched, and how it is found again, or not."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from drivers.simulator import Faults, RobotModel, laser_model, parse_world, simulate, without_pose
from mfslam import recovery, se2
from mfslam.config import Config
from mfslam.frontend import Frontend
from mfslam.metrics import ate
from mfslam.slam import Slam
from mfslam.step_records import PredictedMotion
from tests.rooms import CORRIDOR, NO_PILLARS, ROOM, ROOM_PILLARS, laser, moving_scan

MODEL = laser()
START = np.array([-1.5, -0.9, 0.1])
STEP = np.array([0.08, 0.0, 0.05])


def test_inertia_reaches_half_the_acceleration_times_the_time_squared():
    half_m, half_rad = recovery.reach(1.0)
    assert half_m == pytest.approx(3.0 * (0.02 + 0.5 * 2.0))
    assert half_rad == math.pi  # 6 rad: any heading
    assert recovery.reach(0.0) == recovery.reach(0.3), "stamps of bursts prove no standstill"


def test_a_robot_coasts_through_a_gap_for_a_second():
    step = np.array([0.1, 0.0, 0.02])
    np.testing.assert_array_equal(recovery.coasted(step, 0.1, 0.25), step)
    np.testing.assert_allclose(recovery.coasted(step, 0.1, 0.5), se2.exp(5.0 * se2.log(step)), atol=1e-12)
    np.testing.assert_allclose(recovery.coasted(step, 0.1, 9.0), recovery.coasted(step, 0.1, 1.0))


def test_stamps_that_lie_make_no_motion_unlikely():
    """The same step again after 0.4 s by the stamps, the one before having taken none."""
    step = np.array([0.2, 0.0, 0.1])
    assert recovery.is_likely(step, step, recovery.coasted(step, 0.0, 0.4), 0.4)
    assert not recovery.is_likely(
        step + np.array([0.9, 0.0, 0.0]), step, recovery.coasted(step, 0.1, 0.1), 0.1
    )


def drive(rooms, moved, dt_s, wheels=None):
    """Twelve steps in the first room, then ``moved`` (3,) in ``dt_s`` into the second; the last step and where
    it truly leads in the front end's frame."""
    frontend = Frontend(Config())
    truth = START
    for n in range(13):
        told = None if wheels is None or n == 0 else STEP
        scan = moving_scan(*rooms[0], truth, np.zeros(3), MODEL)
        frontend.process(n, scan, PredictedMotion(np.zeros(3), 0.1 if n else 0.0, told))
        truth = se2.compose(truth, STEP) if n < 12 else truth
    before = frontend.local_T_body
    scan = moving_scan(*rooms[1], se2.compose(truth, moved), np.zeros(3), MODEL)
    step = frontend.process(13, scan, PredictedMotion(np.zeros(3), dt_s, wheels))
    return frontend, step, se2.compose(before, moved)


@pytest.mark.parametrize("moved", [[1.6, 0.5, 1.2], [0.3, 1.0, -2.5], [2.2, 0.2, 0.0]])
def test_after_two_seconds_without_scans_and_wheels_the_robot_is_found_in_its_room(moved):
    room = (ROOM, ROOM_PILLARS)
    frontend, step, truth = drive((room, room), np.array(moved), 2.0)
    off = se2.between(truth, step.local_T_body)
    assert step.found and step.is_keyframe and step.blind_s == pytest.approx(2.0)
    assert math.hypot(off[0], off[1]) < 0.03 and abs(off[2]) < 0.01
    assert len(frontend.recent) > 1


def test_where_every_place_looks_the_same_a_new_map_begins():
    corridor = (CORRIDOR, NO_PILLARS)
    frontend, step, _ = drive((corridor, corridor), np.array([3.0, 0.0, 0.0]), 2.0)
    assert not step.found and step.match is None and step.is_keyframe
    assert [k.scan_index for k in frontend.recent] == [13]


def test_wheels_that_tell_what_inertia_allows_are_not_said_to_jump_a_quarter_turn():
    """What the robot sees turns by 90 deg within a tenth of a second, as a door's swing may make it seem."""
    turned = se2.transform(np.array([0.0, 0.0, 0.5 * math.pi]), ROOM.reshape(-1, 2)).reshape(-1, 4)
    centre = se2.transform(np.array([0.0, 0.0, 0.5 * math.pi]), ROOM_PILLARS[:, :2])
    pillars = np.hstack([centre, ROOM_PILLARS[:, 2:]])
    _, step, truth = drive(((ROOM, ROOM_PILLARS), (turned, pillars)), STEP, 0.1, wheels=STEP)
    off = se2.between(truth, step.local_T_body)
    assert not step.odometry_jump
    assert math.hypot(off[0], off[1]) < 0.1 and abs(off[2]) < 0.1


def test_a_few_points_are_no_proof_that_wheels_jumped():
    """Two posts in the open look like any two posts; one of them is gone and the other stands elsewhere."""
    nothing = np.zeros((1, 4)) + 100.0
    posts = np.array([[1.0, 0.6, 0.1], [2.2, -1.4, 0.1]])
    moved_posts = posts + np.array([0.3, 0.2, 0.0])
    few = laser(n_beams=180)
    frontend = Frontend(Config())
    for n in range(6):
        scan = moving_scan(nothing, posts if n < 5 else moved_posts, START, np.zeros(3), few)
        step = frontend.process(
            n, scan, PredictedMotion(np.zeros(3), 0.1 if n else 0.0, np.zeros(3) if n else None)
        )
    assert not step.odometry_jump
    np.testing.assert_allclose(step.local_T_body, 0.0, atol=0.05)


HALL = """
wall 0 0 14 0 14 9 0 9 0 0
box 4 3 1.6 0.7 20
box 9.5 6 0.8 1.4 0
box 13.5 1 0.9 1.5 0
box 1 8.4 1.8 0.8 0
pillar 10.4 2.2 0.25
path 2 1.2 2
path 12 1.2
path 12 7.8
path 2.5 7
path 2 1.2
path 12 1.2
path 12 5
"""


def test_a_gap_at_speed_without_wheels_is_bridged_and_told():
    """Two seconds without scans in a bend: the map goes on in one piece, by search or by loops."""
    model = laser_model("rplidar-a2", (0.1, 0.0, 0.0))
    robot = dataclasses.replace(RobotModel(), odometry="none", max_speed_m_s=2.0)
    faults = Faults(scan_gaps_s=((6.0, 8.0),))
    simulation = simulate(parse_world(HALL, "hall"), robot, model, seed=3, faults=faults)
    slam = Slam(Config())
    for message in simulation.messages:
        slam.feed(without_pose(message))
    solution = slam.finish()
    assert ate(simulation.truth_world_T_body, solution.world_T_body).translation_m.rmse < 0.05
    assert slam.findings.count("lost-between-scans") == 1
