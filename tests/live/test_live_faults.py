"""`mfslam live` as a whole, under what ends or disturbs it: real bytes on pseudo-terminals, real processes, real signals."""

from __future__ import annotations

import resource
import signal
import time
from pathlib import Path

import numpy as np
from live_command import SIMULATED, gone, live, no_parts, scans_of
from sent_scans import check_recorded, sent_for_s

from drivers.simulator.devices.serve import Cast, SimulatedSensors
from drivers.simulator.devices.wire import LineFault, LineFaults
from mfslam.output import read_map, read_tum

WHEELS = ("radius_left_m=0.077", "radius_right_m=0.077", "track_m=0.33")


def test_cables_bits_lasers_wheels_and_processes_fail_and_it_goes_on(tmp_path: Path) -> None:
    """One drive: one bit in 10,000 flipped on both lines, garbage, half lines, an error code, the laser's cable pulled, the
    wheels silent; the viewer and the back end killed, the engine stalled for 2 s; then Ctrl-C."""
    sent_path, folder = tmp_path / "sent.jsonl", tmp_path / "OUT"
    laser = LineFaults(1e-4, (
        LineFault(1.0, "garbage", 500), LineFault(1.5, "lost", 300), LineFault(2.0, "status", 21), LineFault(7.0, "unplug", 1.0),
    ))  # fmt: skip
    board = LineFaults(1e-4, (LineFault(3.0, "stall", 2.5),))
    cast = Cast("demo", board="lines", laser_faults=laser, board_faults=board, record=str(sent_path))
    with SimulatedSensors(cast) as sim:
        settings = [word for text in WHEELS for word in ("--set", f"wheels.{text}")]
        sensors = ["--lidar", f"urg:{sim.lidar}", "--wheels", f"board:{sim.board}"]
        with live(folder, *sensors, *settings, "--view", "0") as run:
            run.until_recorded(10_000)
            run.kill("viewer")
            run.process.send_signal(signal.SIGSTOP)  # the reader stalls
            time.sleep(2.0)
            run.process.send_signal(signal.SIGCONT)
            run.kill("back end")
            run.until(lambda: "was started again; mapping went on" in run.said)
            run.until_mapped()
            run.until(lambda: sent_for_s(sent_path) > 10.0)
            pids = list(run.children().values())
            run.process.send_signal(signal.SIGINT)
            assert run.ends() == 0, run.said
    assert "Traceback" not in run.said and gone(pids)
    sent, whole, recorded = check_recorded(scans_of(folder / "recording.mcap"), sent_path)
    assert 12 < recorded <= whole < 0.4 * sent
    stamps_ns, poses = read_tum(folder / "trajectory.tum")
    assert np.array_equal(stamps_ns, [scan.stamp_ns for scan in scans_of(folder / "recording.mcap")])
    assert np.ptp(poses[:, 0]) > 3.0 and (read_map(folder / "map.yaml").occupancy == 100).sum() > 300
    told = run.said
    for word in ("viewer's process was killed (SIGKILL)", "process that maps was killed (SIGKILL)",
                 "the line was lost and found again", "checksum"):  # fmt: skip
        assert word in told
    assert no_parts(folder) and not list(folder.glob("map-so-far-*"))


def test_kill_9_of_the_engine_leaves_a_whole_map_and_a_whole_recording(tmp_path: Path) -> None:
    folder = tmp_path / "OUT"
    with live(folder, *SIMULATED, "--view", "0") as run:
        run.until_mapped()
        run.until_recorded(45_000)
        pids = list(run.until(lambda: run.children() if len(run.children()) == 3 else None).values())
        run.process.kill()
        run.process.wait()
    assert gone(pids)
    assert (read_map(folder / "map.yaml").occupancy == 100).sum() > 100
    assert len(scans_of(folder / "recording.mcap")) > 20


def test_kill_9_of_the_acquisition_is_told_and_what_came_is_mapped(tmp_path: Path) -> None:
    folder = tmp_path / "OUT"
    with live(folder, *SIMULATED) as run:
        run.until_recorded(45_000)
        run.kill("acquisition")
        assert run.ends() == 1
    assert "the acquisition process was killed (SIGKILL)" in run.said and "Traceback" not in run.said
    assert len(read_tum(folder / "trajectory.tum")[0]) >= len(scans_of(folder / "recording.mcap")) > 20
    assert (read_map(folder / "map.yaml").occupancy == 100).sum() > 100


def test_a_second_ctrl_c_leaves_at_once(tmp_path: Path) -> None:
    folder = tmp_path / "OUT"
    with live(folder, *SIMULATED) as run:
        run.until_recorded(45_000)
        pids = list(run.children().values())
        run.process.send_signal(signal.SIGINT)
        run.until(lambda: "the final solve" in run.said)
        run.process.send_signal(signal.SIGINT)
        assert run.ends(5.0) == 130
    assert "left at once" in run.said and "Traceback" not in run.said and gone(pids)
    assert len(scans_of(folder / "recording.mcap")) > 20 and no_parts(folder)


def test_a_full_disk_is_told_and_what_was_recorded_stays(tmp_path: Path) -> None:
    folder = tmp_path / "OUT"

    def small_disk() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))

    with live(folder, *SIMULATED, preexec_fn=small_disk) as run:
        assert run.ends() == 1
    assert "Traceback" not in run.said and "file too large" in run.said
    assert len(scans_of(folder / "recording.mcap")) > 5 and no_parts(folder)


def test_sensors_that_are_not_there_are_one_line_and_no_folder(tmp_path: Path) -> None:
    folder = tmp_path / "OUT"
    with live(folder, "--lidar", "urg:/dev/nowhere", "-q") as run:
        assert run.ends() == 1
    assert (
        run.said.splitlines()[-1] == "mfslam: urg:/dev/nowhere: cannot be opened: no such file or directory"
    )
    assert "Traceback" not in run.said and not folder.exists()
