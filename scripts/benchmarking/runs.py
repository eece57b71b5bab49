"""The logs at hand, each mapped in a process of its own and measured."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from drivers.logs import default_presets, open_log
from mfslam.metrics import read_relations, relations_error
from mfslam.output import read_tum
from mfslam.settings import load, preset_path
from mfslam.slam import Slam, Solution
from mfslam.types import MfslamError

SUFFIXES = (".clf", ".log", ".dat", ".bag", ".mcap", ".db3")
PACKED = (".gz", ".bz2")
VARIANTS = {
    "deskew on": [],
    "deskew off": ["deskew.mode=none"],
    "beams reversed": ["sensor.reversed_beams=true"],
}
NO_LOG = "no log that mfslam reads"


@dataclass
class Outcome:
    """One run of `mfslam map`: its cost, its own summary and its error, or why it failed."""

    log: str
    variant: str
    scored: bool
    failure: str | None = None
    cpu_s: float = 0.0
    peak_mb: float = 0.0
    log_s: float = 0.0
    summary: dict[str, Any] = field(default_factory=dict)
    relations: dict[str, Any] | None = None

    @property
    def real_time_factor(self) -> float:
        return self.log_s / self.cpu_s if self.cpu_s else 0.0


def find_logs(folder: Path, only: list[str]) -> list[Path]:
    """Log files below ``folder``, smallest first."""
    if not folder.is_dir():
        raise MfslamError(f"{folder}: no such folder of logs; give one with --data")
    logs = [path for path in folder.rglob("*") if path.is_file() and _is_log(path)]
    wanted = [path for path in logs if not only or any(word in path.name for word in only)]
    if not wanted:
        raise MfslamError(f"{folder}: no log here ({', '.join(SUFFIXES)}) that --only lets through")
    return sorted(wanted, key=lambda path: (path.stat().st_size, path.name))


def _is_log(path: Path) -> bool:
    suffixes = [s for s in path.suffixes if s not in PACKED]
    return bool(suffixes) and suffixes[-1] in SUFFIXES


def log_name(path: Path) -> str:
    return path.name.split(".")[0]


def relations_beside(path: Path) -> Path:
    return path.with_name(f"{log_name(path)}.relations")


def mapped_by_default(path: Path) -> tuple[Slam, Solution]:
    """A log through the engine in this process, by the presets that fit it."""
    config = load([preset_path(preset) for preset in default_presets(str(path))])
    slam = Slam(config)
    with open_log(str(path), config) as log:
        for message in log:
            slam.feed(message)
    return slam, slam.finish()


def run_map(path: Path, variant: str, settings: list[str], out: Path) -> Outcome:
    """Map one log in a process of its own and measure that process."""
    command = [str(Path(sys.executable).parent / "mfslam"), "map", str(path), "-o", str(out), "--quiet"]
    for setting in settings:
        command += ["--set", setting]
    outcome = Outcome(log_name(path), variant, relations_beside(path).is_file())
    with tempfile.TemporaryFile() as said:
        process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=said, stderr=said)
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        said.seek(0)
        lines = said.read().decode(errors="replace").strip().splitlines()
    outcome.cpu_s = usage.ru_utime + usage.ru_stime
    outcome.peak_mb = usage.ru_maxrss / (1024.0 if sys.platform != "darwin" else 1024.0**2)
    if process.returncode:
        outcome.failure = lines[-1] if lines else f"ended with status {process.returncode}"
        return outcome
    outcome.summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    outcome.log_s = outcome.summary["distances"]["log_duration_s"]
    if outcome.scored:
        stamps_ns, poses = read_tum(out / "trajectory.tum")
        relations = read_relations(relations_beside(path))
        outcome.relations = relations_error(stamps_ns, poses, relations).as_json()
    return outcome


def run_all(logs: list[Path], settings: list[str]) -> list[Outcome]:
    outcomes: list[Outcome] = []
    with tempfile.TemporaryDirectory(prefix="mfslam-benchmark-") as scratch:
        say("compiling kernels with a first run (not measured)")
        for index, path in enumerate(logs):  # a log that cannot be mapped compiles nothing
            if not run_map(path, "warm-up", settings, Path(scratch) / f"warm-up-{index}").failure:
                break
        for path in logs:
            scored = relations_beside(path).is_file()
            variants = {"deskew on": VARIANTS["deskew on"]} if scored else VARIANTS
            for variant, extra in variants.items():
                say(f"{log_name(path)}, {variant}")
                out = Path(scratch) / str(len(outcomes))
                outcome = run_map(path, variant, [*settings, *extra], out)
                if NO_LOG in (outcome.failure or ""):  # a table of something else under such a name
                    print(f"benchmark: {path.name} is no log", file=sys.stderr)
                    break
                outcomes.append(outcome)
                if outcomes[-1].failure and not scored:
                    break  # the other variants would fail alike
    return outcomes


def say(text: str) -> None:
    print(f"benchmark: {text}", file=sys.stderr, flush=True)
