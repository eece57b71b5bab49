#!/usr/bin/env python3
"""Pose graphs: optima and certificates, false loops against every kernel, speed beside plain gtsam.

scripts/benchmark_graphs.py                                  # all tables on the terminal
scripts/benchmark_graphs.py --markdown docs/benchmarks.md --json graphs.json
scripts/benchmark_graphs.py --only optima --only speed
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

from benchmarking.graph_optima import optima_table
from benchmarking.graph_outliers import outlier_table
from benchmarking.graph_speed import speed_table
from benchmarking.page import machine, write_markdown
from benchmarking.tables import Table

from mfslam.evaluation.tables import as_text
from mfslam.output import json_text, write_atomically
from mfslam.types import MfslamError

ROOT = Path(__file__).resolve().parent.parent
MARKER = "graphs"
TABLES: dict[str, tuple[str, Callable[[Path], Table]]] = {
    "optima": ("Pose graphs: optima and certificates", optima_table),
    "outliers": ("Pose graphs with false loops: ATE in m (false loops believed)", outlier_table),
    "speed": ("Pose graphs: CPU seconds beside plain gtsam", speed_table),
}


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, default=ROOT.parent / "shared" / "data", help="folder of graphs")
    parser.add_argument("--only", choices=sorted(TABLES), action="append", help="only this table; repeatable")
    parser.add_argument("--json", type=Path, help="write the tables here")
    parser.add_argument("--markdown", type=Path, help="write them into this page, between its markers")
    options = parser.parse_args()
    try:
        if not (options.data / "pose_graphs").is_dir():
            raise MfslamError(
                f"{options.data / 'pose_graphs'}: no such folder of graphs; give one with --data"
            )
        tables = []
        for name in options.only or TABLES:
            title, make = TABLES[name]
            tables.append((title, make(options.data / "pose_graphs")))
            print(f"\n{title}\n\n{as_text(tables[-1][1])}", flush=True)
        if options.json:
            write_atomically(options.json, json_text({"machine": machine(), "tables": dict(tables)}).encode())
        if options.markdown:
            command = " ".join(["scripts/benchmark_graphs.py", *sys.argv[1:]])
            write_markdown(options.markdown, tables, command, MARKER)
    except MfslamError as error:
        print(f"benchmark_graphs: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
