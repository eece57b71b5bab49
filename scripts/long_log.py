#!/usr/bin/env python3
"""Does it scale? A simulated log of 20 km and some 50,000 keyframes, mapped with the default settings.

A robot with a SICK laser visits the 120 rooms of a random office, eleven times over. Prints what mapping costs
(CPU time, peak memory, seconds per stage, the cost of a metre in each quarter of the way) and how exact it is.
The log is kept in the folder, and taken again where it lies there already.

    scripts/long_log.py -o /tmp/long                         # 170 MB, 10 to 20 minutes on one core
    scripts/long_log.py -o /tmp/short --rooms 10 --laps 2
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarking.page import machine
from benchmarking.runs import Outcome, run_map
from benchmarking.tables import Table, accuracy_table, cost_table, growth_table

from mfslam.evaluation.tables import as_text
from mfslam.types import MfslamError

DRIVE = ["--laser", "sick-lms200", "--speed", "1.25", "--seed", "1"]


def simulated_log(folder: Path, rooms: int, laps: int) -> Path:
    """The log, with its truth and relations beside it; simulated where it is not there yet."""
    path = folder / f"office-{rooms}-{laps}.clf"
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        command = [str(Path(sys.executable).parent / "mfslam"), "simulate", f"office:1:{rooms}:{laps}"]
        done = subprocess.run([*command, *DRIVE, "-q", "-o", str(path)], capture_output=True, text=True)
        if done.returncode:
            raise MfslamError(f"the log could not be simulated: {done.stderr.strip()}")
    return path


def stages_table(outcome: Outcome) -> Table:
    seconds = outcome.summary["timings_s"]
    return [["stage", "s"], *([stage, f"{s:.1f}"] for stage, s in seconds.items() if stage != "total")]


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder for the log")
    parser.add_argument("--rooms", type=int, default=60, help="rooms on either side of the corridor (60)")
    parser.add_argument("--laps", type=int, default=11, help="how often all of them are visited (11)")
    parser.add_argument("--set", action="append", default=[], metavar="STAGE.KEY=VALUE", help="a setting")
    options = parser.parse_args()
    try:
        path = simulated_log(options.output, options.rooms, options.laps)
        with tempfile.TemporaryDirectory(prefix="mfslam-long-") as scratch:
            outcome = run_map(path, "deskew on", options.set, Path(scratch) / "out")
    except MfslamError as error:
        print(f"long_log: {error}", file=sys.stderr)
        return 1
    if outcome.failure:
        print(f"long_log: {outcome.failure}", file=sys.stderr)
        return 1
    print(f"{machine()}; {outcome.summary['counts']['keyframes']:,} keyframes")
    for table in (
        *(make([outcome]) for make in (cost_table, growth_table, accuracy_table)),
        stages_table(outcome),
    ):
        print(f"\n{as_text(table)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
