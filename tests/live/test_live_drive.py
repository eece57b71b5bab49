"""`mfslam live` on a good day: with a calibration, while somebody sets the wall clock."""

from __future__ import annotations

import os
import shlex
import signal
from pathlib import Path

import numpy as np
from live_command import SIMULATED, live, scans_of

from drivers.simulator import RobotModel, laser_model, load_world, simulate
from drivers.simulator.simulate import without_pose
from drivers.writers.log import write_log
from mfslam.cli import main
from mfslam.config import Config
from mfslam.output import read_tum
from mfslam.settings import load

CLOCK = """
import os, time
_path, _true_ns = os.environ["WALL_CLOCK_SET_BY"], time.time_ns

def time_ns():
    with open(_path) as file:
        return _true_ns() + int(file.read())

time.time_ns, time.time = time_ns, lambda: 1e-9 * time_ns()
"""


class WallClock:
    """The wall clock as every process of a command sees it, set by so many seconds."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir()
        self._path = folder / "seconds"
        self.set(0.0)
        (folder / "sitecustomize.py").write_text(CLOCK)
        self.environment = os.environ | {"PYTHONPATH": str(folder), "WALL_CLOCK_SET_BY": str(self._path)}

    def set(self, by_s: float) -> None:
        aside = self._path.with_suffix(".new")
        aside.write_text(str(round(by_s * 1e9)))
        aside.replace(self._path)


def calibration(folder: Path) -> tuple[Path, Config]:
    """What `mfslam calibrate` writes of a drive with encoders and the laser 12 cm before them."""
    log, settings = folder / "drive.mcap", folder / "robot.yaml"
    robot = RobotModel(odometry="ticks")
    drive = simulate(load_world("demo"), robot, laser_model("urg-04lx", (0.12, 0.0, 0.0)), seed=1)
    write_log(list(map(without_pose, drive.messages)), log, wheels=robot.wheels)
    assert main(["calibrate", str(log), "-o", str(settings), "-q"]) == 0
    return settings, load([settings])


def test_a_calibrated_robot_is_mapped_as_offline_and_whoever_sets_the_clock_bends_nothing(
    tmp_path: Path,
) -> None:
    settings, config = calibration(tmp_path)
    clock, folder = WallClock(tmp_path / "clock"), tmp_path / "OUT"
    with live(folder, *SIMULATED, "--config", str(settings), env=clock.environment) as run:
        for size, by_s in ((15_000, 3600.0), (30_000, -7200.0), (45_000, 0.0)):
            run.until_recorded(size)
            clock.set(by_s)
        run.until_recorded(60_000)
        run.process.send_signal(signal.SIGINT)
        assert run.ends() == 0, run.said
    scans = scans_of(folder / "recording.mcap")
    steps_s = np.diff([scan.stamp_ns for scan in scans]) * 1e-9
    assert np.all((steps_s > 0.05) & (steps_s < 1.0))  # of every tenth of a second, as the laser turns
    for word in ("clock", "backwards", "jump"):
        assert word not in run.said
    found = load([folder / "config.yaml"])
    assert found.wheels == config.wheels and found.wheels.track_m != RobotModel().wheels.track_m
    assert scans[0].laser.body_T_laser[0] == config.sensor.mount_x_m
    # the command that it tells maps the recording to the same poses
    again = next(line for line in run.said.splitlines() if line.startswith("map again"))
    assert main([*shlex.split(again)[3:], "-q"]) == 0
    stamps_ns, poses = read_tum(folder / "trajectory.tum")
    stamps_again_ns, poses_again = read_tum(tmp_path / "OUT-offline" / "trajectory.tum")
    assert np.array_equal(stamps_ns, stamps_again_ns)
    np.testing.assert_allclose(poses, poses_again, atol=1e-4)
