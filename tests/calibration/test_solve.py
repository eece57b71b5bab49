"""Calibration against laser motions whose truth is known: a simulated drive, its encoders, exact poses with noise."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from drivers.simulator import RobotModel, drive, load_world
from drivers.simulator.robot import encoder_ticks, wheel_angles
from mfslam import se2
from mfslam.calibration.outcome import IN_PLACE, calibration_of
from mfslam.calibration.problem import Problem
from mfslam.calibration.record import Record
from mfslam.calibration.solve import Solved, solve
from mfslam.calibration.start import Start, find_start
from mfslam.calibration.wheel_track import DifferentialDrive
from mfslam.config import Config, WheelsConfig
from mfslam.types import FloatArray, Laser

NOMINAL = WheelsConfig(radius_left_m=0.08, radius_right_m=0.08, track_m=0.33, ticks_per_turn=256)
MOUNT = np.array([0.12, -0.03, math.radians(4.0)])
DELAY_S = -0.15


def make_record(seed: int = 0, signs: FloatArray | None = None, world: str = "office:2:3:1") -> Record:
    """Radii 1 % too small and 2 % too large, track 20 % wider than told, the laser as `MOUNT` says, scans `DELAY_S` old."""
    robot = RobotModel(wheels=NOMINAL, radius_error_left=-0.01, radius_error_right=0.02, track_error=0.2)
    motion = drive(load_world(world, 1.0), robot)
    rng = np.random.default_rng(seed)
    knots = np.arange(0.0, motion.duration_s, 0.02)
    ticks = encoder_ticks(wheel_angles(motion, robot, knots, rng), NOMINAL)
    if signs is not None:
        ticks = ticks @ signs.T
    rolled = np.diff(ticks, axis=0, prepend=ticks[:1]) * (2.0 * math.pi / 256.0 * 0.08)
    forward, turned = rolled.mean(axis=1), (rolled[:, 1] - rolled[:, 0]) / 0.33
    steps = se2.exp(np.stack([forward, np.zeros_like(forward), turned], axis=1))
    times = np.arange(0.5, motion.duration_s - 0.5, 0.1)
    poses = se2.compose(motion.at(times + DELAY_S), MOUNT)
    poses = se2.compose(poses, rng.normal(size=poses.shape) * np.array([0.003, 0.003, 0.001]))
    laser = Laser("test", np.zeros(1), np.zeros(1), 0.0, 4.0, 0.02, np.zeros(3))
    return Record(times, poses, np.ones(len(times), dtype=np.bool_), laser, knots, steps)


def solved(record: Record) -> tuple[Solved, Start]:
    start = find_start(record, record.windows(), NOMINAL.track_m, True)
    problem = Problem(record, DifferentialDrive(NOMINAL.track_m, start.signs), True, start.delay_s)
    values = problem.start.copy()
    values[2], values[-2] = start.track_share, start.delay_s
    return solve(problem, values), start


TRUTH = np.array([0.99, 1.02, 1.2, *MOUNT, DELAY_S, 0.0])


def test_radii_track_mount_and_delay_are_found_from_far_off() -> None:
    found, _ = solved(make_record())
    error = np.abs(found.values - TRUTH)
    assert np.all(error[:2] < 0.002)
    assert error[2] < 0.005 * 1.2
    assert np.all(error[3:5] < 0.005)
    assert error[5] < math.radians(0.3)
    assert error[6] < 0.003


def test_errors_are_as_large_as_their_covariance_says() -> None:
    nees = []
    for seed in range(8):
        found, _ = solved(make_record(seed))
        off = found.values - TRUTH
        nees.append(float(off @ np.linalg.solve(found.covariance, off)) / len(off))
    assert 0.3 < np.mean(nees) < 2.0


@pytest.mark.parametrize(
    ("signs", "words"),
    [
        (np.array([[0.0, 1.0], [1.0, 0.0]]), "swapped"),
        (np.diag([-1.0, 1.0]), "left wheel counts backwards"),
        (np.diag([1.0, -1.0]), "right wheel counts backwards"),
    ],
)
def test_wheels_wired_wrong_are_named_and_the_rest_is_found_all_the_same(
    signs: FloatArray, words: str
) -> None:
    found, start = solved(make_record(signs=signs))
    assert words in start.words
    assert abs(found.values[2] - 1.2) < 0.01
    assert abs(found.values[6] - DELAY_S) < 0.003


def test_wheels_as_told_have_nothing_odd() -> None:
    assert solved(make_record())[1].words == ""


def test_what_a_straight_drive_does_not_show_is_said_with_the_manoeuvre_that_would() -> None:
    record = make_record()
    times = record.times_s
    straight = np.stack([0.5 * times, np.zeros_like(times), np.zeros_like(times)], axis=1)
    rng = np.random.default_rng(1)
    poses = se2.compose(straight, MOUNT) + rng.normal(size=straight.shape) * 0.001
    steps = np.tile([0.01, 0.0, 0.0], (len(record.knots_s), 1))
    record = replace(record, world_T_laser=poses, told_steps=steps)
    problem = Problem(record, DifferentialDrive(NOMINAL.track_m, np.eye(2)))
    start = Start(0.0, np.eye(2), 1.0, 1.0)
    calibration = calibration_of(solve(problem), record, start, Config(wheels=NOMINAL))
    assert calibration["mount_yaw"].observable
    for name in ("track", "mount_x", "delay"):
        assert not calibration[name].observable, name
    assert IN_PLACE in calibration["track"].line()
    assert "track_m" not in calibration.settings().get("wheels", {})
