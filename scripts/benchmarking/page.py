"""Tables as text and as Markdown, and the page that holds them."""

from __future__ import annotations

import datetime
import os
import platform
from pathlib import Path

from benchmarking.tables import Table
from mfslam.output import write_atomically
from mfslam.types import MfslamError

LOGS = "benchmark"  # marker of the tables of logs


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


def markers(name: str) -> tuple[str, str]:
    return f"<!-- {name}: begin -->", f"<!-- {name}: end -->"


def write_markdown(path: Path, tables: list[tuple[str, Table]], command: str, marker: str = LOGS) -> None:
    """Replace the part of ``path`` between the markers of that name, or start the page."""
    opening, closing = markers(marker)
    section = [
        "",
        f"Measured on {datetime.date.today().isoformat()}, {machine()}, with `{command}`.",
        "",
    ]
    for title, table in tables:
        section += [f"## {title}", "", as_markdown(table), ""]
    if not path.is_file():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f"# Benchmarks\n\n{opening}\n{closing}\n", encoding="utf-8")
    replace_section(path, marker, "\n".join(section[:-1]))


def replace_section(page: Path, marker: str, body: str) -> None:
    """Put the body between the markers of that name. Raises MfslamError where the page has none."""
    opening, closing = markers(marker)
    before, begin, rest = page.read_text(encoding="utf-8").partition(opening)
    _, end, after = rest.partition(closing)
    if not begin or not end:
        raise MfslamError(
            f"{page}: expected the markers {opening} and {closing}; put them where the tables belong"
        )
    write_atomically(page, f"{before}{opening}\n{body}\n{closing}{after}".encode())
