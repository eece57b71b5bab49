#!/usr/bin/env python3
"""Where the time of `mfslam map` goes, and how fast each inner loop is at its own work.

Maps one log in this process and counts, around every kernel and solve, calls, seconds and what was worked on:
bytes parsed, points matched, points averaged, rays and cells traced. Seconds are CPU seconds; a machine that is
busy with other work makes them longer all the same.

    scripts/profile_stages.py LOG
    scripts/profile_stages.py LOG --set refine.passes=1
"""

from __future__ import annotations

import argparse
import contextlib
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from benchmarking.page import as_markdown
from benchmarking.tables import Table

from drivers.logs import default_presets, open_log
from mfslam.cli import main as mfslam
from mfslam.evaluation.tables import as_text
from mfslam.graph import PoseGraph
from mfslam.kernels import align, cells, correlate, evidence, raytrace, reach, scans
from mfslam.settings import load, preset_path
from mfslam.skeleton import Skeleton
from mfslam.types import MfslamError


@dataclass
class Tally:
    """Calls of one thing, their seconds, and how much of ``unit`` they worked on."""

    name: str
    unit: str
    calls: int = 0
    seconds: float = 0.0
    work: float = 0.0

    def row(self, total_s: float) -> list[str]:
        each_ns = f"{1e9 * self.seconds / self.work:.1f}" if self.work else "-"
        share = f"{100.0 * self.seconds / total_s:.1f}"
        rate = f"{self.work / self.seconds / 1e6:.2f}" if self.seconds else "-"
        return [self.name, f"{self.calls:,}", f"{self.seconds:.2f}", share, self.unit, rate, each_ns]


Work = Callable[[tuple[Any, ...], Any], float]
# what is counted: where it is, its name, the unit of its work, and how much of it a call did
WATCHED: list[tuple[Any, str, str, Work]] = [
    (scans, "oriented_points", "beams", lambda a, _: len(a[0])),
    (cells, "build_cells", "points", lambda a, _: len(a[0])),
    (cells, "smooth_surface", "points", lambda a, _: len(a[0][1])),
    (align, "point_to_line", "points x iterations", lambda a, out: len(a[2]) * out[4]),
    (correlate, "likelihood_grid", "cells", lambda _, out: out.size),
    (correlate, "pyramid", "cells", lambda _, out: out.size),
    (correlate, "branch_and_bound", "top blocks x points", lambda a, _: _top_blocks(a)),
    (evidence, "evidence_grid", "rays", lambda a, _: len(a[2])),
    (evidence, "agreement", "points", lambda a, _: len(a[4])),
    (reach, "path_covariances", "knots", lambda a, _: len(a[2])),
    (raytrace, "trace_beams", "cells", lambda a, _: _cells_of(a)),
    (PoseGraph, "_solve", "poses", lambda a, _: len(a[0])),
    (Skeleton, "relative_covariance", "marginals", lambda _, __: 1.0),
    (PoseGraph, "settle_disputes", "calls", lambda _, __: 1.0),
    (PoseGraph, "optimize", "edges", lambda a, _: len(a[1])),
]


def _top_blocks(a: tuple[Any, ...]) -> float:
    """Lookups that a branch and bound cannot avoid: every point, in every block of the top level."""
    levels, cell, points, angles, half_window = a[0], a[2], a[3], a[5], a[6]
    per_side = 2.0 * half_window / cell / 2.0 ** (len(levels) - 1) + 1.0
    return float(len(points) * len(angles) * per_side**2)


def _cells_of(a: tuple[Any, ...]) -> float:
    """Cells that beams cross, by their length (a beam along the diagonal crosses more)."""
    starts, stops, cell = a[0], a[1], a[5]
    length = np.abs(np.asarray(stops) - np.asarray(starts)).sum(axis=-1)
    return float(np.nansum(length) / cell)


def watch(owner: Any, name: str, unit: str, work: Work) -> Tally:
    """Put a counter around a function of a module or class."""
    inner = getattr(owner, name)
    tally = Tally(name.strip("_"), unit)

    def counted(*arguments: Any, **named: Any) -> Any:
        start = time.process_time()
        out = inner(*arguments, **named)
        tally.seconds += time.process_time() - start
        tally.calls += 1
        with contextlib.suppress(TypeError, IndexError, ValueError):  # called in another way: time alone
            tally.work += float(work(arguments, out))
        return out

    setattr(owner, name, counted)
    return tally


def parsing(path: Path) -> Tally:
    """Reading the log alone, by its bytes on the disk."""
    tally = Tally("parsing alone", "bytes on disk", 1)
    start = time.process_time()
    with open_log(path, load([preset_path(name) for name in default_presets(path)])) as log:
        for _ in log:
            pass
    tally.seconds, tally.work = time.process_time() - start, float(path.stat().st_size)
    return tally


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("log", type=Path)
    parser.add_argument("--set", action="append", default=[], metavar="STAGE.KEY=VALUE", help="a setting")
    parser.add_argument("--markdown", action="store_true", help="print the table as Markdown")
    options = parser.parse_args()
    try:
        tallies = [parsing(options.log)]
    except MfslamError as error:
        print(f"profile_stages: {error}", file=sys.stderr)
        return 1
    tallies += [watch(*item) for item in WATCHED]
    settings = [part for setting in options.set for part in ("--set", setting)]
    with tempfile.TemporaryDirectory(prefix="mfslam-profile-") as scratch:
        start = time.process_time()
        status = mfslam(["map", str(options.log), "-o", str(Path(scratch) / "out"), "-q", *settings])
        total_s = time.process_time() - start
    if status:
        return status
    head = ["what", "calls", "s", "% of the run", "unit", "million per s", "ns each"]
    done = sorted((t for t in tallies if t.calls), key=lambda t: -t.seconds)
    table: Table = [head, *(t.row(total_s) for t in done)]
    print(
        f"{options.log.name}: {total_s:.1f} CPU s\n\n{(as_markdown if options.markdown else as_text)(table)}"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
