"""`mfslam live` as a whole, under what ends or disturbs it: real bytes on pseudo-terminals, real processes, real signals."""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from drivers.logs import open_log
from drivers.simulator.devices.serve import Cast, SimulatedSensors
from drivers.simulator.devices.wire import LineFault, LineFaults
from mfslam.config import Config
from mfslam.output import read_map, read_tum
from mfslam.types import Scan

WHEELS = ("radius_left_m=0.077", "radius_right_m=0.077", "track_m=0.33")
SIMULATED = ("--lidar", "sim:demo", "--wheels", "sim")
ROLES = {"acquisition": "drivers.acquisition", "back end": "mfslam.live", "viewer": "mfslam.viewer"}


class Live:
    """The command in a process of its own; what it says goes to a file."""

    def __init__(self, folder: Path, *more: str, **options: Any) -> None:
        self.folder, self._log = folder, folder.with_name(f"{folder.name}.log")
        arguments = [sys.executable, "-m", "mfslam.cli", "live", "-o", str(folder), "--map-every", "1", *more]
        with self._log.open("w") as log:
            self.process = subprocess.Popen(arguments, stdout=log, stderr=log, **options)

    @property
    def said(self) -> str:
        return self._log.read_text()

    def until(self, what: Any, timeout_s: float = 90.0) -> Any:
        end_s = time.monotonic() + timeout_s
        while not (value := what()):
            assert self.process.poll() is None, f"it has ended: {self.said}"
            assert time.monotonic() < end_s, f"it does not come; said so far: {self.said}"
            time.sleep(0.05)
        return value

    def until_recorded(self, size_bytes: int) -> None:
        path = self.folder / "recording.mcap"
        self.until(lambda: path.exists() and path.stat().st_size > size_bytes)

    def until_mapped(self) -> None:
        self.until((self.folder / "map.yaml").exists)

    def children(self) -> dict[str, int]:
        """Process ids by role."""
        out = {}
        for process in Path("/proc").glob("[0-9]*"):
            try:
                stat = (process / "stat").read_text().rpartition(")")[2].split()
                words = (process / "cmdline").read_text().split("\0")
            except OSError:
                continue
            if stat[0] != "Z" and int(stat[1]) == self.process.pid:
                out |= {role: int(process.name) for role, module in ROLES.items() if module in words}
        return out

    def kill(self, role: str) -> None:
        os.kill(self.until(lambda: self.children().get(role)), signal.SIGKILL)

    def ends(self, timeout_s: float = 90.0) -> int:
        return self.process.wait(timeout_s)


@contextmanager
def live(folder: Path, *more: str, **options: Any) -> Iterator[Live]:
    run = Live(folder, *more, **options)
    try:
        yield run
    finally:
        if run.process.poll() is None:
            run.process.kill()
            run.process.wait()


def gone(pids: list[int], timeout_s: float = 20.0) -> bool:
    """Whether all of these have ended by then."""

    def runs(pid: int) -> bool:
        try:
            return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
        except OSError:
            return False

    end_s = time.monotonic() + timeout_s
    while any(map(runs, pids)):
        if time.monotonic() > end_s:
            return False
        time.sleep(0.05)
    return True


def scans_of(path: Path) -> list[Scan]:
    with open_log(path, Config()) as log:
        return [message for message in log if isinstance(message, Scan)]


def no_parts(folder: Path) -> bool:
    return not list(folder.glob(".*.mfslam-part"))


def test_cables_bits_lasers_wheels_and_processes_fail_and_it_goes_on(tmp_path: Path) -> None:
    """One drive: flipped bits on both lines, garbage, half lines, an error code, the laser off, its cable pulled, the
    wheels silent; the viewer and the back end killed, the engine stalled for 2 s; then Ctrl-C."""
    sent_path, folder = tmp_path / "sent.jsonl", tmp_path / "OUT"
    laser = LineFaults(2e-5, (
        LineFault(15.0, "garbage", 500), LineFault(15.6, "lost", 300), LineFault(16.2, "status", 21),
        LineFault(17.2, "laser-off"), LineFault(19.5, "unplug", 1.0),
    ))  # fmt: skip
    board = LineFaults(1e-4, (LineFault(16.0, "stall", 2.5),))
    cast = Cast("demo", board="lines", laser_faults=laser, board_faults=board, record=str(sent_path))
    with SimulatedSensors(cast) as sim:
        began_s = time.monotonic()  # the times of the faults count from here
        settings = [word for text in WHEELS for word in ("--set", f"wheels.{text}")]
        sensors = ["--lidar", f"urg:{sim.lidar}", "--wheels", f"board:{sim.board}"]
        with live(folder, *sensors, *settings, "--view", "0") as run:
            run.until_recorded(40_000)
            run.kill("viewer")
            run.process.send_signal(signal.SIGSTOP)  # the reader stalls
            time.sleep(2.0)
            run.process.send_signal(signal.SIGCONT)
            run.kill("back end")
            run.until(lambda: "was started again; mapping went on" in run.said)
            run.until_mapped()
            run.until(lambda: time.monotonic() - began_s > 23.0)
            pids = list(run.children().values())
            run.process.send_signal(signal.SIGINT)
            assert run.ends() == 0, run.said
    assert "Traceback" not in run.said and gone(pids)
    check_recording(folder / "recording.mcap", sent_path)
    stamps_ns, poses = read_tum(folder / "trajectory.tum")
    assert np.array_equal(stamps_ns, [scan.stamp_ns for scan in scans_of(folder / "recording.mcap")])
    assert np.ptp(poses[:, 0]) > 3.0 and (read_map(folder / "map.yaml").occupancy == 100).sum() > 300
    told = run.said
    for word in ("viewer's process was killed (SIGKILL)", "process that maps was killed (SIGKILL)", "status-21",
                 "the line was lost and found again", "checksum"):  # fmt: skip
        assert word in told
    assert no_parts(folder) and not list(folder.glob("map-so-far-*"))


def blocks(sent_path: Path) -> list[dict[str, Any]]:
    """The laser's scans as they went over the line, whole or not."""
    lines = sent_path.read_text(encoding="utf-8").split("\n")[:-1]  # the last one may be half written
    return [block for block in map(json.loads, lines) if block["line"] == "lidar" and "values" in block]


def check_recording(path: Path, sent_path: Path) -> None:
    """Every scan that came over whole is in it, but for what was under way when the line was closed."""
    recorded = {scan.ranges_m.tobytes() for scan in scans_of(path)}
    whole = [block for block in blocks(sent_path) if block["intact"]]
    kept = [_as_recorded(block) in recorded for block in whole]
    begins = [block["step_0_s"] for block in whole]
    closed_s = [a for a, b in pairwise(begins) if b - a > 0.8] + begins[-1:]
    missed = [at for at, k in zip(begins, kept, strict=True) if not k]
    assert all(any(0.0 <= end - at < 1.0 for end in closed_s) for at in missed)
    assert len(missed) < 20 < 30 < sum(kept)


def _as_recorded(block: dict[str, Any]) -> bytes:
    values = np.array(block["values"])
    metres = np.where(values < 20, np.nan, values * 1e-3).astype(np.float32)
    metres[metres >= np.float32(5.6)] = np.inf
    return metres.tobytes()


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
