"""From starts that are far off, on logs as a robot writes them: recovered, or named."""

from __future__ import annotations

import dataclasses
import math
from functools import cache
from typing import Any

import numpy as np
import pytest

from drivers.laser_models import LogGeometry, laser_from
from drivers.simulator import RobotModel, Simulation, laser_model, load_world, simulate
from mfslam.calibration.outcome import Calibration
from mfslam.calibration.passes import calibrate_by_turns
from mfslam.config import Config, WheelsConfig
from mfslam.settings import load, preset_path
from mfslam.slam import Slam, Solution
from mfslam.types import IntArray, Scan, WheelTicks

WHEELS = WheelsConfig(radius_left_m=0.08, radius_right_m=0.08, track_m=0.33, ticks_per_turn=256)
MOUNT = (0.12, 0.03, math.radians(5.0))
GYRO_SCALE, GYRO_BIAS = 1.02, 0.01
TOLERANCES = {
    "radius_left": 0.002 * 0.08, "radius_right": 0.002 * 0.08, "track": 0.005 * 0.33,
    "mount_x": 0.005, "mount_y": 0.005, "mount_yaw": 0.3, "delay": 0.003, "turn_period": 0.01,
}  # fmt: skip
TRUTH = {
    "radius_left": 0.08, "radius_right": 0.08, "track": 0.33, "mount_x": 0.12, "mount_y": 0.03, "mount_yaw": 5.0,
    "delay": 0.0, "turn_period": 0.1,
}  # fmt: skip
AS_TOLD = np.eye(2, dtype=np.int64)


@cache
def drive(late_s: float = 0.0, backwards: bool = False, drift: float = 0.0) -> Simulation:
    """A drive through an office; ``backwards``: the laser turns against the order of its beams."""
    robot = RobotModel(
        wheels=WHEELS, max_speed_m_s=1.0, odometry="ticks", slip_m_per_sqrt_m=0.003, gyro_rate_hz=50.0,
        gyro_scale_error=GYRO_SCALE - 1.0, gyro_bias_rad_s=GYRO_BIAS,
    )  # fmt: skip
    model = laser_model("urg-04lx", MOUNT)
    order = slice(None, None, -1 if backwards else 1)
    laser = dataclasses.replace(model.laser, offsets_s=model.laser.offsets_s[order].copy())
    model = dataclasses.replace(model, laser=laser, stamp_delay_s=late_s, clock_drift=drift)
    return simulate(load_world("office:1:4:1", 1.0), robot, model, seed=3)


def config_with(**changes: dict[str, Any]) -> Config:
    """The truth, but for the changes of each stage."""
    config = load([preset_path("urg-04lx")])
    mount = {"mount_x_m": MOUNT[0], "mount_y_m": MOUNT[1], "mount_yaw_deg": math.degrees(MOUNT[2])}
    truth: dict[str, dict[str, Any]] = {"wheels": WHEELS.model_dump(), "sensor": mount}
    for stage, values in changes.items():
        truth[stage] = truth.get(stage, {}) | values
    return config.model_copy(
        update={stage: getattr(config, stage).model_copy(update=values) for stage, values in truth.items()}
    )


def calibrated(simulation: Simulation, config: Config, wiring: IntArray = AS_TOLD) -> Calibration:
    """``wiring`` (2, 2): ticks as the log tells them, of the true left and right ones."""
    angles = simulation.scans[0].laser.angles_rad
    told = LogGeometry(len(angles), float(angles[0]), float(angles[1] - angles[0]))

    def mapped(config: Config) -> tuple[Slam, Solution]:
        slam, laser = Slam(config), laser_from(config.sensor, told)
        sides = slice(None, None, -1 if config.wheels.swap_sides else 1)
        for message in simulation.messages:
            if isinstance(message, Scan):
                message = dataclasses.replace(message, laser=laser)
            elif isinstance(message, WheelTicks):
                left, right = (wiring @ [message.left, message.right])[sides].tolist()
                message = dataclasses.replace(message, left=left, right=right)
            slam.feed(message)
        return slam, slam.finish()

    found = calibrate_by_turns(mapped, config, lambda: False, lambda _: None)
    assert found is not None
    return found


def check(found: Calibration, **truth: float) -> None:
    for name, value in (TRUTH | truth).items():
        assert found[name].value == pytest.approx(value, abs=TOLERANCES[name]), name


@pytest.mark.parametrize(
    "wrong",
    [
        {"wheels": {"radius_left_m": 0.088, "radius_right_m": 0.072}},
        {"wheels": {"radius_left_m": 0.088, "radius_right_m": 0.088}},
        {"wheels": {"track_m": 0.396}},
        {"sensor": {"mount_yaw_deg": 25.0}},
        {"sensor": {"turn_period_s": 0.05}},
        {"sensor": {"turn_period_s": 0.0}},
    ],
    ids=["radius 10 %, each its way", "radii 10 %", "track 20 %", "mount 20 deg", "half period", "snapshot"],
)  # fmt: skip
def test_wrong_geometry_is_put_right(wrong: dict[str, dict[str, Any]]) -> None:
    found = calibrated(drive(), config_with(**wrong))
    assert found.oddities == ""
    check(found)


def test_a_delay_of_150_ms_is_found_with_everything_else_wrong_and_the_gyro_beside_it() -> None:
    wheels = {"radius_left_m": 0.088, "radius_right_m": 0.088, "track_m": 0.396}
    found = calibrated(drive(late_s=0.15), config_with(wheels=wheels, sensor={"mount_yaw_deg": 25.0}))
    check(found, delay=-0.15)
    for name, truth in {"gyro_scale": GYRO_SCALE, "gyro_bias": GYRO_BIAS}.items():
        assert abs(found[name].value - truth) < 4.0 * found[name].sigma
        assert found[name].observable and found[name].significant
    assert found.settings()["imu"]["gyro_scale"] == pytest.approx(GYRO_SCALE, abs=0.005)


@pytest.mark.parametrize(
    ("wiring", "words", "settings"),
    [
        ([[0, 1], [1, 0]], "left and right wheel are swapped", (True, False, False)),
        ([[-1, 0], [0, 1]], "the left wheel counts backwards", (False, True, False)),
        ([[1, 0], [0, -1]], "the right wheel counts backwards", (False, False, True)),
        ([[0, -1], [1, 0]], "swapped and the right wheel counts backwards", (True, False, True)),
    ],
)
def test_wheels_wired_wrong_are_named_and_put_right(
    wiring: list[list[int]], words: str, settings: tuple[bool, bool, bool]
) -> None:
    found = calibrated(drive(), config_with(), np.array(wiring))
    assert words in found.oddities
    wheels = found.settings()["wheels"]
    keys = ("swap_sides", "left_reversed", "right_reversed")
    assert tuple(wheels.get(key, False) for key in keys) == settings
    check(found)


def test_a_laser_that_turns_against_the_order_of_its_beams_is_found() -> None:
    found = calibrated(drive(backwards=True), config_with())
    assert found.oddities == "the laser turns against the order of its beams"
    assert found.settings()["sensor"]["reversed_beams"] is True
    check(found, turn_period=-0.1)


def test_a_clock_that_drifts_is_taken_off_and_the_delay_is_that_at_the_start_of_the_log() -> None:
    found = calibrated(drive(late_s=0.02, drift=5e-4), config_with())
    sensor = found.settings()["sensor"]
    assert sensor["clock_drift"] == pytest.approx(5e-4, abs=4.0 * found["clock_drift"].sigma)
    assert sensor["transport_delay_s"] == pytest.approx(-0.02, abs=0.004)
    assert found["delay"].value == pytest.approx(-0.02 - 5e-4 * found.middle_s, abs=0.003)
