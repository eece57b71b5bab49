"""scripts/benchmarking/pose_bound.py: the bound of one scan by finite differences, and what makes it lower."""

from __future__ import annotations

import dataclasses
import importlib
from pathlib import Path

import numpy as np
import pytest

from drivers.simulator import Motion, RobotModel, laser_model, load_world, parse_world, simulate
from drivers.simulator.sensing import cast_scans
from mfslam import se2

SCRIPTS = Path(__file__).resolve().parent.parent / "scripts"
ROOM = "wall -3 -2 4 -2 4 3 -3 3 -3 -2\npillar 1.5 1 0.3\nstart 0 0 0.3\n"


@pytest.fixture
def bound_of(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.syspath_prepend(SCRIPTS)
    return importlib.import_module("benchmarking.pose_bound").bound_of


def test_one_scan_of_a_robot_that_stands_is_known_as_its_beams_tell(bound_of):
    world, robot = parse_world(ROOM), RobotModel()
    model = laser_model("generic", (0.1, 0.0, 0.2))
    at_once = dataclasses.replace(model.laser, offsets_s=np.zeros_like(model.laser.offsets_s))
    model = dataclasses.replace(model, laser=at_once, period_s=100.0)

    def standing(moved):
        return Motion.from_twists(
            [1.0], [[0.0, 0.0, 0.0]], se2.compose(world.start, se2.exp(np.array(moved)))
        )

    step = 1e-6
    first = np.zeros(1)
    there = cast_scans(world, standing(np.zeros(3)), model, first)[0]
    by_pose = [
        (cast_scans(world, standing(step * unit), model, first)[0] - there) / step for unit in np.eye(3)
    ]
    jacobian = np.stack(by_pose, axis=1)
    jacobian = jacobian[np.all(np.abs(jacobian) < 50.0, axis=1)]  # without beams that meet another wall then
    variance = at_once.range_sigma_m**2 + model.range_step_m**2 / 12.0
    expected = np.diag(np.linalg.inv(jacobian.T @ jacobian / variance))
    log = simulate(world, robot, model, motion=standing(np.zeros(3)))
    found = bound_of(world, robot, model, log)
    assert len(log.instants_s) == 1
    assert found.translation_m == pytest.approx(np.sqrt(expected[0] + expected[1]), rel=0.02)
    assert found.rotation_deg == pytest.approx(np.degrees(np.sqrt(expected[2])), rel=0.02)


def test_it_grows_with_the_noise_of_ranges_and_less_than_that_with_wheels(bound_of):
    world, robot = load_world("demo"), RobotModel(slip_m_per_sqrt_m=0.004)
    model = laser_model("generic")
    noisy = dataclasses.replace(model, laser=dataclasses.replace(model.laser, range_sigma_m=0.06))
    surely, hardly = (bound_of(world, robot, m, simulate(world, robot, m)) for m in (model, noisy))
    assert 1.3 * surely.rotation_deg < hardly.rotation_deg < 3.1 * surely.rotation_deg
    assert 1.3 * surely.translation_m < hardly.translation_m < 3.1 * surely.translation_m
