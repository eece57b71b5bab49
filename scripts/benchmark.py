#!/usr/bin/env python3
"""Accuracy, real-time factor and memory of every log at hand, as a table.

Runs `mfslam map` as its users do, one log at a time, and scores what it leaves. A log with relations beside
it (NAME.relations) is scored against them; one without is judged by the crispness of its points, with
deskew on, off and in the reversed beam order.

    scripts/benchmark.py                             # a table on the terminal
    scripts/benchmark.py --markdown docs/benchmarks.md --json benchmark.json
    scripts/benchmark.py --only office --set deskew.mode=none
"""

from __future__ import annotations

import argparse
import datetime
import json
import os
import platform
import subprocess
import sys
import tempfile
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from mfslam.metrics import read_relations, relations_error
from mfslam.output import json_text, read_tum, write_atomically
from mfslam.types import MfslamError

ROOT = Path(__file__).resolve().parent.parent
SUFFIXES = (".clf", ".log", ".dat", ".bag", ".mcap", ".db3")
PACKED = (".gz", ".bz2")
VARIANTS = {
    "deskew on": [],
    "deskew off": ["deskew.mode=none"],
    "beams reversed": ["sensor.reversed_beams=true"],
}
NO_LOG = "no log that mfslam reads"
BEGIN, END = "<!-- benchmark: begin -->", "<!-- benchmark: end -->"


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
        outcome.relations = relations_error(
            stamps_ns, poses, read_relations(relations_beside(path))
        ).as_json()
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


# --- tables ------------------------------------------------------------------------------------------

Table = list[list[str]]


def accuracy_table(outcomes: list[Outcome]) -> Table:
    head = ["log", "relations", "mean m", "median m", "p99 m", "mean deg", "median deg", "p99 deg"]
    rows = []
    for o in outcomes:
        if o.relations is None:
            continue
        matched, total = o.relations["matched"], o.relations["matched"] + o.relations["unmatched"]
        shift, turn = o.relations["translation_m"], o.relations["rotation_deg"]
        rows.append(
            [o.log, f"{matched:,} of {total:,}"]
            + [f"{shift[key]:.4f}" for key in ("mean", "median", "p99")]
            + [f"{turn[key]:.3f}" for key in ("mean", "median", "p99")]
        )
    return [head, *rows]


def cost_table(outcomes: list[Outcome]) -> Table:
    head = ["log", "scans", "travelled m", "log s", "CPU s", "times real time", "peak MB"]
    rows = []
    for o in outcomes:
        if o.failure is None and o.variant == "deskew on":
            counts, distances = o.summary["counts"], o.summary["distances"]
            size = [f"{counts['scans']:,}", f"{distances['travelled_m']:.0f}", f"{o.log_s:.0f}"]
            cost = [f"{o.cpu_s:.1f}", f"{o.real_time_factor:.0f}", f"{o.peak_mb:.0f}"]
            rows.append([o.log, *size, *cost])
    return [head, *rows]


def crispness_table(outcomes: list[Outcome]) -> Table:
    head = ["log", "variant", "2 cm cells", "against off", "entropy nats"]
    plain = {
        o.log: o.summary["crispness"]["cells"]
        for o in outcomes
        if o.variant == "deskew off" and not o.failure
    }
    rows = []
    for o in outcomes:
        if o.failure is None and o.relations is None:
            cells = o.summary["crispness"]["cells"]
            change = f"{100.0 * (cells / plain[o.log] - 1.0):+.1f} %" if o.log in plain else "-"
            rows.append(
                [o.log, o.variant, f"{cells:,}", change, f"{o.summary['crispness']['entropy_nats']:.3f}"]
            )
    return [head, *rows]


def failures_table(outcomes: list[Outcome]) -> Table:
    return [
        ["log", "variant", "why it failed"],
        *([o.log, o.variant, o.failure] for o in outcomes if o.failure),
    ]


def tables(outcomes: list[Outcome]) -> list[tuple[str, Table]]:
    all_tables = [
        ("Relations error (Kuemmerle et al. 2009)", accuracy_table(outcomes)),
        ("Cost of the whole command, kernels compiled", cost_table(outcomes)),
        ("Crispness of the re-projected points (lower is sharper)", crispness_table(outcomes)),
        ("Not mapped", failures_table(outcomes)),
    ]
    return [(title, table) for title, table in all_tables if len(table) > 1]


def as_text(table: Table) -> str:
    widths = [max(len(row[c]) for row in table) for c in range(len(table[0]))]
    return "\n".join(
        "  ".join(
            cell.ljust(w) if c == 0 else cell.rjust(w)
            for c, (cell, w) in enumerate(zip(row, widths, strict=True))
        )
        for row in table
    )


def as_markdown(table: Table) -> str:
    head, *rows = [f"| {' | '.join(row)} |" for row in table]
    return "\n".join([head, "|" + " --- |" * len(table[0]), *rows])


def machine() -> str:
    model = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.is_file():
        names = [
            line.partition(":")[2].strip()
            for line in cpuinfo.read_text().splitlines()
            if "model name" in line
        ]
        model = names[0] if names else model
    return f"{model}, {os.cpu_count()} cores, {platform.system()}, Python {platform.python_version()}"


def write_markdown(path: Path, outcomes: list[Outcome], command: str) -> None:
    """Replace the part of ``path`` between the markers, or start the page."""
    section = [
        BEGIN,
        "",
        f"Measured on {datetime.date.today().isoformat()}, {machine()}, with `{command}`.",
        "",
    ]
    for title, table in tables(outcomes):
        section += [f"## {title}", "", as_markdown(table), ""]
    text = path.read_text(encoding="utf-8") if path.is_file() else f"# Benchmarks\n\n{BEGIN}\n{END}\n"
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise MfslamError(f"{path}: expected the markers {BEGIN} and {END}; put them where the tables belong")
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, (before + "\n".join(section) + END + after).encode())


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
    options = parser.parse_args()
    try:
        outcomes = run_all(find_logs(options.data, options.only), options.set)
        for title, table in tables(outcomes):
            print(f"\n{title}\n\n{as_text(table)}")
        if options.json:
            runs = [asdict(o) | {"real_time_factor": o.real_time_factor} for o in outcomes]
            write_atomically(options.json, json_text({"machine": machine(), "runs": runs}).encode())
        if options.markdown:
            command = " ".join(["scripts/benchmark.py", *sys.argv[1:]])
            write_markdown(options.markdown, outcomes, command)
    except MfslamError as error:
        print(f"benchmark: {error}", file=sys.stderr)
        return 1
    return 1 if any(o.failure and o.scored for o in outcomes) else 0


if __name__ == "__main__":
    sys.exit(main())
