#!/usr/bin/env python
"""How late the pose of a live run is, and how good: logs through `mfslam replay`, beside `mfslam map`.

    scripts/live_latency.py LOG... [--hour] [--speed max] [--markdown docs/live.md]

Latency is that of a scan from being handed to the engine until its pose is known: wall time, and the processor's time alone,
which a busy machine does not lengthen. Errors are those of the relations beside the log (LOG.relations).
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from benchmarking.page import machine, write_markdown
from benchmarking.runs import relations_beside
from benchmarking.tables import Table

from mfslam.evaluation.tables import as_text
from mfslam.metrics.relations import read_relations, relations_error
from mfslam.output import read_tum
from mfslam.types import MfslamError

HOUR = ["office:1:8:16", "--laser", "urg-04lx", "--speed", "1.0", "--seed", "1"]
TRAJECTORIES = {
    "as told at once": "live.tum",
    "before the final solve": "online.tum",
    "after it": "trajectory.tum",
}


def mfslam(*words: str) -> None:
    command = [str(Path(sys.executable).parent / "mfslam"), *words]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise MfslamError(f"{' '.join(command)}: {done.stderr.strip()}")


def hour(folder: Path) -> Path:
    """A log of about an hour through an office, 10 Hz, 682 beams, with its truth."""
    log = folder / "office-hour.mcap"
    mfslam("simulate", *HOUR, "-q", "-o", str(log))
    return log


def error_of(run: Path, name: str, log: Path) -> tuple[float, float]:
    """Mean relations error (m, deg)."""
    stamps_ns, poses = read_tum(run / name)
    error = relations_error(stamps_ns, poses, read_relations(relations_beside(log)))
    return error.translation_m.mean, error.rotation_deg.mean


def measure(log: Path, speed: str, scratch: Path) -> tuple[list[str], list[str]]:
    """A row of the table of latencies and one of that of errors."""
    name = log.name.split(".")[0]
    live, offline = scratch / f"{name}-live", scratch / f"{name}-map"
    mfslam("replay", str(log), "-o", str(live), "--speed", speed, "-q")
    mfslam("map", str(log), "-o", str(offline), "-q")
    told: dict[str, Any] = json.loads((live / "live.json").read_text())
    summary = json.loads((live / "summary.json").read_text())
    latency, memory = told["latency_ms"], told["memory"]
    travelled_m = summary["distances"]["travelled_m"]
    row = [
        name, f"{told['counts']['scans']:,}", f"{travelled_m:.0f}", f"{latency['median']:.2f}", f"{latency['p99']:.1f}",
        f"{latency['cpu_p99']:.1f}", f"{latency['worst']:.0f}", f"{latency['cpu_worst']:.1f}", f"{memory['engine_mb']:.0f}",
        f"{memory['back_end_mapping_mb']:.0f}", f"{memory['back_end_kb_per_m']:.0f}", f"{memory['copies_mb']:.0f}",
        f"{memory['back_end_mb']:.0f}", str(told["counts"]["scans_dropped"]),
    ]  # fmt: skip
    errors = [error_of(offline, "trajectory.tum", log)]
    errors += [error_of(live, file, log) for file in TRAJECTORIES.values()]
    return row, [name, *(f"{m:.4f} / {deg:.3f}" for m, deg in errors)]


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("logs", metavar="LOG", nargs="*", type=Path)
    parser.add_argument("--hour", action="store_true", help="a simulated hour, too")
    parser.add_argument("--speed", default="max", help="of the replay (max)")
    parser.add_argument(
        "--markdown", metavar="PAGE", type=Path, help="put the tables there, between their markers"
    )
    options = parser.parse_args()
    latencies: Table = [[
        "log", "scans", "m", "median ms", "99 % ms", "99 % ms, processor alone", "worst ms", "worst ms, processor alone", "engine MB",
        "map process MB, driving", "kB per m", "a copy MB", "map process MB, final solve", "scans dropped",
    ]]  # fmt: skip
    errors: Table = [["log", "mfslam map", *TRAJECTORIES]]
    try:
        with tempfile.TemporaryDirectory(prefix="mfslam-live-") as folder:
            scratch = Path(folder)
            for log in [*options.logs, *([hour(scratch)] if options.hour else [])]:
                latency, error = measure(log, options.speed, scratch)
                latencies.append(latency)
                errors.append(error)
                print(as_text([latencies[0], latency]), as_text([errors[0], error]), sep="\n", flush=True)
        print(f"\n{machine()}\n{as_text(latencies)}\n\n{as_text(errors)}")
        if options.markdown is not None:
            command = f"scripts/live_latency.py {' '.join(log.name for log in options.logs)}"
            command += (" --hour" if options.hour else "") + f" --speed {options.speed}"
            tables = [("From a scan to its pose", latencies), ("Error, m / deg", errors)]
            write_markdown(options.markdown, tables, command, marker="live")
    except MfslamError as trouble:
        print(f"live_latency: {trouble}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
