"""Poses that came with the scans: read at other instants than the scans, their heading at yet another one."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.simulator import RobotModel, drive, load_world
from mfslam import se2
from mfslam.calibration.problem import Problem
from mfslam.calibration.record import Record
from mfslam.calibration.run import scatter_over_lengths
from mfslam.calibration.solve import solve
from mfslam.calibration.told_poses import heading_ahead_s, paired
from mfslam.calibration.wheel_track import PoseOdometry
from mfslam.types import FloatArray, Laser

MOUNT = np.array([-0.04, 0.01, 0.02])
TIMES_S = np.arange(1.0, 250.0, 0.2)
EVERY = np.ones(len(TIMES_S) - 1, dtype=np.bool_)
MOTION = drive(load_world("office:2:3:2", 1.0), RobotModel())


def told(late_s: float, ahead_s: float) -> FloatArray:
    """(S, 3) poses that lag behind the scans, their heading less so."""
    poses = MOTION.at(TIMES_S - late_s)
    poses[:, 2] = MOTION.at(TIMES_S - late_s + ahead_s)[:, 2]
    return poses


def record(poses: FloatArray) -> Record:
    rng = np.random.default_rng(0)
    laser = se2.compose(MOTION.at(TIMES_S), MOUNT)
    laser = se2.compose(laser, se2.exp(rng.normal(size=laser.shape) * [0.003, 0.003, 0.001]))
    steps = np.vstack([np.full((1, 3), np.nan), se2.between(poses[:-1], poses[1:])])
    assumed = Laser("test", np.zeros(1), np.zeros(1), 0.0, 4.0, 0.02, np.zeros(3))
    return Record(
        TIMES_S, laser, np.ones(len(TIMES_S), dtype=np.bool_), assumed, TIMES_S, steps, with_scans=True
    )


@pytest.mark.parametrize("ahead_s", [0.0, 0.06, -0.1])
def test_a_heading_read_at_another_instant_is_found(ahead_s: float) -> None:
    assert heading_ahead_s(told(0.3, ahead_s), TIMES_S, EVERY) == pytest.approx(ahead_s, abs=0.005)


def test_poses_that_stand_still_say_nothing_of_their_heading() -> None:
    assert heading_ahead_s(np.zeros_like(told(0.0, 0.0)), TIMES_S, EVERY) == 0.0


def test_the_laser_is_found_though_poses_were_read_at_other_instants() -> None:
    problem = Problem(record(paired(told(0.3, 0.06), TIMES_S, EVERY)), PoseOdometry(), True, 0.3)
    start = problem.start.copy()
    start[-2] = 0.3
    found = solve(problem, start)
    assert found.values[-2] == pytest.approx(0.3, abs=0.02)
    assert np.abs(found.values[3:6] - MOUNT).max() < 0.005


def test_where_windows_of_other_lengths_disagree_sigma_says_so() -> None:
    sigmas = []
    for late_s in (0.0, 0.3):
        problem = Problem(record(told(late_s, 0.0)), PoseOdometry(), clock=False)
        found = solve(problem)
        off = found.values[3:6] - MOUNT
        scatter = scatter_over_lengths(problem, 0.0, found)
        sigmas.append(np.sqrt(np.diag(found.covariance + scatter))[3:6])
        assert np.all(np.abs(off) < 4.0 * sigmas[-1])
    assert np.all(sigmas[1] > sigmas[0])
