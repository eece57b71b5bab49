"""`mfslam map --calibrate auto` on a log whose stamps are late: found, used where the map gets sharper, and told."""

from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path

import numpy as np
import pytest

from drivers.simulator import RobotModel, laser_model, load_world, simulate
from drivers.simulator.simulate import without_pose
from drivers.writers.log import write_log
from mfslam.cli import main
from mfslam.commands.map_log import _as_sharp
from mfslam.settings import load
from mfslam.types import Scan


@pytest.fixture(scope="module")
def late(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log of odometry and scans whose stamps are 50 ms late."""
    laser = dataclasses.replace(laser_model("fast"), stamp_delay_s=0.05)
    simulation = simulate(load_world("demo"), RobotModel(), laser, seed=1)
    path = tmp_path_factory.mktemp("late") / "late.mcap"
    write_log(list(map(without_pose, simulation.messages)), path)
    return path


def config_value(run: Path, key: str) -> float:
    lines = (run / "config.yaml").read_text().splitlines()
    (line,) = [line for line in lines if line.strip().startswith(f"{key}:")]
    return float(line.split(":")[1].split("#")[0])


@pytest.mark.parametrize("how", ["auto", "off"])
def test_late_stamps_are_found_and_the_map_is_made_with_them(late: Path, how: str, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert main(["map", str(late), "-o", str(out), "-q", "--calibrate", how]) == 0
    summary = json.loads((out / "summary.json").read_text())
    if how == "off":
        assert "calibration" not in summary
        return
    calibration = summary["calibration"]
    assert calibration["used"] is True
    assert calibration["found"]["delay"]["found"] == pytest.approx(-0.05, abs=0.003)
    assert config_value(out, "transport_delay_s") == pytest.approx(-0.05, abs=0.003)


def test_a_laser_whose_ranges_are_wrong_is_corrected_without_any_wheels(tmp_path: Path) -> None:
    log, out = tmp_path / "wave.mcap", tmp_path / "out"
    simulation = simulate(load_world("office:2:3:1", 1.0), RobotModel(), laser_model("urg-04lx"), seed=1)
    scans = [message for message in simulation.messages if isinstance(message, Scan)][:400]
    told = [
        scan.ranges_m + 0.025 * np.sin(2.0 * np.pi * np.nan_to_num(scan.ranges_m, posinf=0.0) / 2.1)
        for scan in scans
    ]
    wrong = [
        dataclasses.replace(scan, ranges_m=ranges_m.astype(np.float32), odom_T_body=None)
        for scan, ranges_m in zip(scans, told, strict=True)
    ]
    write_log(wrong, log)
    assert main(["map", str(log), "-o", str(out), "-q", "--preset", "urg-04lx"]) == 0
    calibration = json.loads((out / "summary.json").read_text())["calibration"]
    assert calibration["used"] is True and calibration["range_errors"]["significant"] is True
    before, after = calibration["sharpness"]["before"], calibration["sharpness"]["after"]
    assert after["cells"] < before["cells"] and after["entropy_bits"] < before["entropy_bits"] - 0.05
    assert after["plane_thickness_mean_m"] < 0.9 * before["plane_thickness_mean_m"]
    errors_m = load([out / "config.yaml"]).sensor.range_error_m
    assert np.ptp(errors_m) > 0.04
    assert "calibrated" in (out / "report.html").read_text()


def test_a_map_that_gets_blunter_by_either_measure_is_refused() -> None:
    before = {"cells": 1000.0, "entropy_bits": 10.0}
    assert _as_sharp({"cells": 990.0, "entropy_bits": 9.9}, before)
    assert _as_sharp({"cells": 1001.0, "entropy_bits": 10.001}, before)
    assert not _as_sharp({"cells": 990.0, "entropy_bits": 10.1}, before)
    assert not _as_sharp({"cells": 1010.0, "entropy_bits": 9.0}, before)


@pytest.mark.parametrize(
    ("settings", "why"),
    [
        (["robot.odometry=none"], "no wheels in it that turn"),
        (["laser.scan_rate_hz=0.5"], r"only \d+ scans"),
    ],
)
def test_a_log_that_gives_too_little_is_refused_in_one_line_that_says_why(
    settings: list[str], why: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, out = tmp_path / "log.mcap", tmp_path / "robot.yaml"
    said = [part for setting in settings for part in ("--set", setting)]
    assert main(["simulate", "demo", "-o", str(log), "-q", "--laser", "fast", *said]) == 0
    assert main(["calibrate", str(log), "-o", str(out), "-q"]) == 1
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert re.search(why, line) and not out.exists()
