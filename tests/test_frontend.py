"""Scan after scan in a known room: prediction, recovery from jumps, keyframes."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from mfslam import se2
from mfslam.config import Config
from mfslam.frontend import Frontend
from mfslam.recovery import free_motion_sigmas
from mfslam.step_records import NOTHING_KNOWN, PredictedMotion
from tests.rooms import CORRIDOR, NO_PILLARS, ROOM, ROOM_PILLARS, laser, moving_scan

DT_S = 0.1
TWIST = np.array([0.8, 0.0, 0.7])
START = np.array([-1.5, -0.9, 0.1])
MODEL = laser(turn_s=0.08)


def drive(
    count, wheels=lambda n, step: step, twist=TWIST, room=(ROOM, ROOM_PILLARS), gyro=False, start=START
):
    """Feed scans on an arc; ``wheels`` makes of the true step what the wheels tell. Steps and true poses."""
    frontend, steps = Frontend(Config()), []
    truth = se2.exp(DT_S * np.arange(count)[:, None] * twist)
    true_step = se2.exp(DT_S * twist)
    for n in range(count):
        told = None if n == 0 else wheels(n, true_step)
        motion = PredictedMotion(
            twist if told is not None or n == 0 else se2.log(frontend.last_step) / DT_S,
            DT_S if n else 0.0,
            told,
            float(true_step[2]) if gyro and n else None,
        )
        steps.append(
            frontend.process(n, moving_scan(*room, se2.compose(start, truth[n]), twist, MODEL), motion)
        )
    return frontend, steps, truth


def worst(steps, truth):
    off = se2.between(truth, np.array([s.local_T_body for s in steps]))
    return np.hypot(off[:, 0], off[:, 1]).max(), np.abs(off[:, 2]).max()


def test_the_first_scan_is_the_origin_and_a_keyframe():
    frontend = Frontend(Config())
    step = frontend.process(0, moving_scan(ROOM, ROOM_PILLARS, START, np.zeros(3), MODEL), NOTHING_KNOWN)
    assert step.is_keyframe and step.match is None
    np.testing.assert_array_equal(step.local_T_body, np.zeros(3))


@pytest.mark.parametrize(
    "wheels",
    [
        lambda n, step: step,
        lambda n, step: step * 1.1,
        lambda n, step: step + np.array([0.0, 0.0, 0.02]),
        lambda n, step: None,
        lambda n, step: step if n % 7 else None,
    ],
    ids=["exact", "10 % too long", "turning too much", "none", "now and then"],
)
def test_the_room_is_followed_whatever_the_wheels_say(wheels):
    _, steps, truth = drive(25, wheels)
    shift_m, turn_rad = worst(steps, truth)
    assert shift_m < 0.02 and turn_rad < 0.02


@pytest.mark.parametrize("jump", [[0.9, 0.0, 0.0], [0.0, 0.0, 1.5], [-0.5, 0.5, -1.0]])
def test_a_jump_of_the_wheels_is_noticed_and_undone(jump):
    told = lambda n, step: se2.compose(step, np.array(jump)) if n == 12 else step  # noqa: E731
    _, steps, truth = drive(20, told)
    shift_m, turn_rad = worst(steps, truth)
    assert shift_m < 0.03 and turn_rad < 0.015
    assert [n for n, s in enumerate(steps) if s.odometry_jump] == [12]
    # a match that found back by itself needs no search
    assert steps[12].searched or steps[12].match.inlier_ratio > 0.9


def test_a_gyro_tells_the_turn_that_wheels_do_not():
    slipping = lambda n, step: np.array([step[0], step[1], 0.0])  # noqa: E731
    spin = np.array([0.0, 0.0, 2.5])
    _, steps, truth = drive(15, slipping, twist=spin, gyro=True)
    assert worst(steps, truth)[1] < 0.01


def test_along_a_bare_corridor_the_wheels_decide():
    ahead = np.array([1.0, 0.0, 0.0])
    _, steps, truth = drive(
        30, lambda n, step: step * 0.9, ahead, room=(CORRIDOR, NO_PILLARS), start=np.array([0.0, 0.2, 0.0])
    )
    last = steps[-1].local_T_body
    assert last[0] == pytest.approx(0.9 * truth[-1, 0], abs=0.05)
    assert abs(last[1]) < 0.01 and abs(last[2]) < 0.01
    assert np.linalg.eigvalsh(steps[-1].match.information[:2, :2])[0] < 500.0


def test_keyframes_come_by_distance_and_by_angle():
    config = Config().frontend
    for twist, per_keyframe in (
        (np.array([1.0, 0.0, 0.0]), config.keyframe_distance_m / 0.1),
        (np.array([0.0, 0.0, 1.0]), math.radians(config.keyframe_angle_deg) / 0.1),
    ):
        _, steps, _ = drive(28, twist=twist)
        indices = np.flatnonzero([s.is_keyframe for s in steps])
        assert np.all(np.abs(np.diff(indices) - math.ceil(per_keyframe)) <= 1)


def test_only_so_many_keyframes_make_up_the_recent_map():
    config = Config()
    frontend = Frontend(
        config.model_copy(update={"frontend": config.frontend.model_copy(update={"local_keyframes": 3})})
    )
    for n in range(10):
        pose = se2.compose(START, np.array([0.35 * n, 0.0, 0.0]))
        motion = PredictedMotion(np.zeros(3), 0.5, np.array([0.35, 0.0, 0.0]) if n else None)
        frontend.process(n, moving_scan(ROOM, ROOM_PILLARS, pose, np.zeros(3), MODEL), motion)
    assert [k.scan_index for k in frontend.recent] == [7, 8, 9]


def test_blind_scans_are_carried_by_the_wheels():
    """A robot whose laser is covered for a second comes out where its wheels say."""
    frontend, steps = Frontend(Config()), []
    truth = se2.exp(DT_S * np.arange(25)[:, None] * TWIST)
    for n in range(25):
        scan = moving_scan(ROOM, ROOM_PILLARS, se2.compose(START, truth[n]), TWIST, MODEL)
        if 8 <= n < 18:
            scan = dataclasses.replace(scan, ranges_m=np.full_like(scan.ranges_m, np.nan))
        motion = PredictedMotion(TWIST, DT_S if n else 0.0, se2.exp(DT_S * TWIST) if n else None)
        steps.append(frontend.process(n, scan, motion))
    shift_m, turn_rad = worst(steps, truth)
    assert shift_m < 0.05 and turn_rad < 0.03


def test_inertia_bounds_a_robot_that_nobody_watches():
    """Half the highest acceleration times the time squared, and never less than what a match is worth."""
    np.testing.assert_allclose(free_motion_sigmas(0.1) - 0.02, [0.01, 0.0025, 0.02], atol=1e-12)
    np.testing.assert_array_equal(free_motion_sigmas(0.0), free_motion_sigmas(0.02))
    np.testing.assert_array_equal(free_motion_sigmas(60.0), free_motion_sigmas(2.0))
