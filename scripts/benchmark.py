#!/usr/bin/env python3
"""Accuracy, real-time factor and memory of every log at hand, as a table.

Runs `mfslam map` as its users do, one log at a time, and scores what it leaves. A log with relations beside
it (NAME.relations) is scored against them; one without is judged by the crispness of its points, with
deskew on, off and in the reversed beam order.

    scripts/benchmark.py                             # a table on the terminal
    scripts/benchmark.py --markdown docs/benchmarks.md --json benchmark.json
    scripts/benchmark.py --only office --set deskew.mode=none
    scripts/benchmark.py --check                     # fails when accuracy fell by more than 10 %
    scripts/benchmark.py --simulated                 # long simulated offices with exact truth instead
    scripts/benchmark.py --ablation                  # what each part of the method is worth instead
    scripts/benchmark.py --nees                      # whether stated covariances are true, by relations
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from dataclasses import asdict
from pathlib import Path

from benchmarking.check import complaints, stored_figures
from benchmarking.page import machine, write_markdown
from benchmarking.relation_nees import nees_tables
from benchmarking.runs import find_logs, relations_beside, run_all
from benchmarking.simulated import ablation_table, simulated_table
from benchmarking.tables import tables

from mfslam.evaluation.tables import as_text
from mfslam.output import json_text, write_atomically
from mfslam.types import MfslamError

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "benchmarks.md"


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, default=ROOT.parent / "shared" / "data", help="folder of logs")
    parser.add_argument(
        "--only", action="append", default=[], help="only logs whose name holds this; repeatable"
    )
    parser.add_argument(
        "--set", action="append", default=[], metavar="STAGE.KEY=VALUE", help="passed to every run"
    )
    parser.add_argument("--json", type=Path, help="write all figures here")
    parser.add_argument("--markdown", type=Path, help="write the tables into this page, between its markers")
    parser.add_argument(
        "--check",
        action="store_true",
        help="map only logs with relations; fail when accuracy is more than 10 %% worse than docs/benchmarks.md",
    )
    parser.add_argument("--simulated", action="store_true", help="long simulated offices, by laser")
    parser.add_argument("--ablation", action="store_true", help="one part of the method left out at a time")
    parser.add_argument(
        "--nees", action="store_true", help="stated covariances of logs with relations against these"
    )
    options = parser.parse_args()
    command = " ".join(["scripts/benchmark.py", *sys.argv[1:]])
    try:
        if options.simulated or options.ablation or options.nees:
            instead(options, command)
            return 0
        logs = find_logs(options.data, options.only)
        if options.check:
            logs = [path for path in logs if relations_beside(path).is_file()]
            stored_figures(PAGE)  # before the work
        outcomes = run_all(logs, options.set)
        for title, table in tables(outcomes):
            print(f"\n{title}\n\n{as_text(table)}")
        if options.json:
            runs = [asdict(o) | {"real_time_factor": o.real_time_factor} for o in outcomes]
            write_atomically(options.json, json_text({"machine": machine(), "runs": runs}).encode())
        if options.markdown:
            write_markdown(options.markdown, tables(outcomes), command)
    except MfslamError as error:
        print(f"benchmark: {error}", file=sys.stderr)
        return 1
    if options.check:
        worse = complaints(outcomes, PAGE)
        for line in worse:
            print(f"benchmark: {line}", file=sys.stderr)
        print("accuracy: " + ("worse than stored" if worse else "as stored, or better"))
        return 1 if worse else 0
    return 1 if any(o.failure and o.scored for o in outcomes) else 0


def instead(options: argparse.Namespace, command: str) -> None:
    """The tables that are asked for by name, each with markers of its own."""
    made = {}
    if options.simulated:
        made["simulated"] = [("Simulated offices with exact truth", simulated_table(options.set))]
    if options.ablation:
        logs = find_logs(options.data, options.only)
        with tempfile.TemporaryDirectory(prefix="mfslam-ablation-") as scratch:
            made["ablation"] = [
                ("Without one part of the method", ablation_table(logs, options.set, Path(scratch)))
            ]
    if options.nees:
        made["nees"] = nees_tables(find_logs(options.data, options.only))
    for marker, several in made.items():
        for title, table in several:
            print(f"\n{title}\n\n{as_text(table)}")
        if options.markdown:
            write_markdown(options.markdown, several, command, marker)


if __name__ == "__main__":
    sys.exit(main())
