#!/usr/bin/env python3
"""Pose graphs: optima and certificates, false loops against every kernel, speed beside plain gtsam.

scripts/benchmark_graphs.py                                  # all tables on the terminal
scripts/benchmark_graphs.py --markdown docs/benchmarks.md --json graphs.json    # row by row, as they come
scripts/benchmark_graphs.py --only optima --only speed
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

from benchmarking.graph_optima import optima_table
from benchmarking.graph_outliers import outlier_table
from benchmarking.graph_speed import speed_table
from benchmarking.page import machine, write_markdown
from benchmarking.tables import Table

from mfslam.output import json_text, write_atomically
from mfslam.types import MfslamError

ROOT = Path(__file__).resolve().parent.parent
# by name, which is that of its markers in the page too: title, rows
TABLES: dict[str, tuple[str, Callable[[Path], Iterator[list[str]]]]] = {
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
        tables: dict[str, Table] = {}
        for name in options.only or TABLES:
            title, make = TABLES[name]
            print(f"\n{title}\n", flush=True)
            tables[title] = []
            for row in make(options.data / "pose_graphs"):
                tables[title].append(row)
                print(" | ".join(row), flush=True)
                write(options, name, title, tables)
    except MfslamError as error:
        print(f"benchmark_graphs: {error}", file=sys.stderr)
        return 1
    return 0


def write(options: argparse.Namespace, name: str, title: str, tables: dict[str, Table]) -> None:
    """What there is of the tables, after every row: some take an hour."""
    if options.json:
        write_atomically(options.json, json_text({"machine": machine(), "tables": tables}).encode())
    if options.markdown:
        command = " ".join(["scripts/benchmark_graphs.py", *sys.argv[1:]])
        write_markdown(options.markdown, [(title, tables[title])], command, f"graphs-{name}")


if __name__ == "__main__":
    sys.exit(main())
