#!/usr/bin/env python3
"""The paper's experiments on the simulator, and what goes beyond them: docs/paper.md with its figures.

Runs every section, draws its figures and writes the page, with a table of the paper's claims against what
was measured. The numbers behind the page are kept as JSON beside the figures; with --only, sections that
are not run are taken from there as they were.

    scripts/reproduce_paper.py                             # all: docs/paper.md, docs/images/paper/
    scripts/reproduce_paper.py --only aisles               # one section again
    scripts/reproduce_paper.py --quick -o /tmp/paper       # the short version that the tests run
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import sys
import time
from dataclasses import asdict
from importlib import import_module
from pathlib import Path
from typing import Any

from paper.page import page_text
from paper.section import Effort, Section

from mfslam.output import json_text, write_atomically
from mfslam.types import MfslamError

SECTIONS = ("equations", "scan_error", "aisles", "graph_on_top", "beyond")
FIGURES = Path("images", "paper")
NUMBERS = "numbers.json"
REPOSITORY = Path(__file__).resolve().parent.parent


def run_sections(names: list[str], effort: Effort) -> dict[str, dict[str, Any]]:
    """Every section by name, as plain data, with the seconds that it took."""
    done = {}
    for name in names:
        print(f"reproduce_paper: {name} ...", file=sys.stderr, flush=True)
        start_s = time.monotonic()
        section: Section = import_module(f"paper.{name}").run(effort)
        seconds = time.monotonic() - start_s
        done[name] = {**asdict(section), "seconds": seconds, "quick": effort.quick}
        print(f"reproduce_paper: {name} took {seconds:.0f} s", file=sys.stderr, flush=True)
    return done


def read_numbers(path: Path) -> dict[str, Any]:
    """Sections of an earlier run; none where there was none. Raises MfslamError for anything else."""
    if not path.is_file():
        return {}
    try:
        numbers = json.loads(path.read_text(encoding="utf-8"))
        return {name: numbers[name] for name in SECTIONS if name in numbers}
    except (OSError, ValueError, TypeError) as error:
        raise MfslamError(
            f"{path}: expected the numbers of an earlier run ({error}): remove it and run all sections"
        ) from None


def parse_arguments(arguments: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="short version: same code, coarser sampling")
    parser.add_argument("--only", nargs="+", choices=SECTIONS, metavar="SECTION", help=", ".join(SECTIONS))
    parser.add_argument("--jobs", type=int, default=2, help="processes at the same time (default: 2)")
    parser.add_argument(
        "-o", "--out", type=Path, help="folder of the page (default: docs/; with --quick: out/paper/)"
    )
    parser.add_argument("--json", type=Path, help="write the numbers of this run there, too")
    options = parser.parse_args(arguments)
    if options.jobs < 1:
        parser.error(f"--jobs: expected 1 or more, got {options.jobs}")
    if options.out is None:  # a short run must not take the place of the page
        options.out = REPOSITORY / ("out/paper" if options.quick else "docs")
    return options


def main(arguments: list[str] | None = None) -> int:
    options = parse_arguments(arguments)
    figures = options.out / FIGURES
    try:
        figures.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise MfslamError(f"{figures}: cannot be made: {(error.strerror or str(error)).lower()}") from None
    wanted = [name for name in SECTIONS if options.only is None or name in options.only]
    present = [name for name in wanted if importlib.util.find_spec(f"paper.{name}") is not None]
    kept = read_numbers(figures / NUMBERS) if options.only is not None else {}
    done = run_sections(present, Effort(options.quick, options.jobs, figures))
    numbers = {name: {**kept, **done}[name] for name in SECTIONS if name in kept or name in done}
    write_atomically(figures / NUMBERS, json_text(numbers).encode())
    page = options.out / "paper.md"
    write_atomically(page, page_text(numbers, FIGURES.as_posix()).encode())
    if options.json is not None:
        write_atomically(options.json, json_text(done).encode())
    print(page)
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except MfslamError as error:
        sys.exit(f"reproduce_paper: {error}")
