#!/usr/bin/env python
"""What a live run believes before its final solve, by how long ago the map was last refined, in minutes of the log.

    scripts/live_ages.py LOG [--minutes 20,10,5,2.5]

Copies are forked from the map process's engine at those times and waited for; errors are those of the relations beside the
log (LOG.relations).
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np
from benchmarking.page import machine
from benchmarking.runs import relations_beside
from benchmarking.tables import Table

from drivers.logs import default_presets, open_log
from mfslam.evaluation.tables import as_text
from mfslam.live.belief import Belief, Refined
from mfslam.live.mapper import Mapper
from mfslam.metrics.relations import Relations, read_relations, relations_error
from mfslam.settings import load, preset_path
from mfslam.types import IntArray, MfslamError, Scan

Copy = tuple[float, Refined, IntArray]  # minutes before the end, what was found, edges that it knew


def mapped(log: Path, minutes: list[float]) -> tuple[Mapper, list[Copy]]:
    """The engine at the log's end, and the copies on the way."""
    config = load([preset_path(name) for name in default_presets(log)])
    with open_log(log, config) as opened:
        messages = list(opened)
    stamps_ns = [m.stamp_ns for m in messages if isinstance(m, Scan)]
    due_ns = [(stamps_ns[-1] - round(m * 60e9), m) for m in sorted(minutes, reverse=True)]
    mapper, copies, number = Mapper(config, None), [], 0
    for message in messages:
        is_scan = isinstance(message, Scan)
        mapper.feed(number if is_scan else -1, message)
        number += is_scan
        if is_scan and due_ns and message.stamp_ns >= due_ns[0][0]:
            copies.append((due_ns.pop(0)[1], *copied(mapper)))
    mapper.slam.place_last()
    return mapper, copies


def copied(mapper: Mapper) -> tuple[Refined, IntArray]:
    edges, count = mapper.slam.graph.numbers_in_use(), len(mapper.slam.keyframes)
    mapper.start_copy()
    while not (done := mapper.harvest()):
        time.sleep(0.1)
    refined = done[0][0]
    if refined is None or refined.error is not None:
        raise MfslamError("a copy has died" if refined is None else str(refined.error))
    return Refined(refined.keyframes[:count], refined.scans, refined.covariance, None), edges


def row(mapper: Mapper, belief: Belief, relations: Relations, when: str) -> list[str]:
    stamps_ns = np.array([scan.stamp_ns for scan in mapper.slam.scans])
    error = relations_error(stamps_ns, belief.trajectory(mapper.slam), relations)
    return [when, f"{error.translation_m.mean:.4f}", f"{error.rotation_deg.mean:.3f}"]


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("log", metavar="LOG", type=Path)
    parser.add_argument("--minutes", default="20,10,5,2.5", help="before the end (20,10,5,2.5)")
    options = parser.parse_args()
    try:
        relations = read_relations(relations_beside(options.log))
        mapper, copies = mapped(options.log, [float(text) for text in options.minutes.split(",")])
        table: Table = [["refined, min before the end", "m", "deg"]]
        table.append(row(mapper, Belief(), relations, "never"))
        for minutes, refined, edges in copies:
            belief = Belief()
            belief.take(refined, edges)
            table.append(row(mapper, belief, relations, f"{minutes:g}"))
    except (MfslamError, ValueError) as trouble:
        print(f"live_ages: {trouble}", file=sys.stderr)
        return 1
    print(f"{machine()}\n{as_text(table)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
