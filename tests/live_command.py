"""`mfslam live` in a process of its own, for tests of the whole command."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from drivers.logs import open_log
from mfslam.config import Config
from mfslam.types import Scan

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
