"""Short logs for tests of whole commands."""

from __future__ import annotations

import bz2
import gzip
from functools import cache
from itertools import islice
from pathlib import Path

from drivers.simulator import RobotModel, Simulation, laser_model, load_world, simulate
from drivers.writers.log import write_log
from mfslam.types import Scan


@cache
def drive(laser: str = "fast") -> Simulation:
    """A drive through the demo's rooms."""
    return simulate(load_world("demo"), RobotModel(), laser_model(laser), seed=1)


def carmen_lines(folder: Path, scans: int = 100) -> list[str]:
    """FLASER lines of 361 beams at the beginning of a `drive`."""
    path = folder / "drive.clf"
    messages = drive("sick-lms291").messages
    end = [n for n, message in enumerate(messages) if isinstance(message, Scan)][scans]
    write_log(messages[:end], path)
    lines = path.read_text(encoding="ascii").splitlines()
    path.unlink()
    return [line for line in lines if line.startswith("FLASER")]


def head_of_log(source: Path, target: Path, word: bytes, count: int) -> Path:
    """The beginning of a recorded text log, up to ``count`` lines that start with ``word``."""
    opener = {".gz": gzip.open, ".bz2": bz2.open}.get(source.suffix, open)
    seen = 0
    with opener(source, "rb") as file, target.open("wb") as out:
        for line in islice(file, 1_000_000):
            seen += line.startswith(word)
            if seen > count:
                break
            out.write(line)
    return target
