"""Whether today's accuracy is still what docs/benchmarks.md says."""

from __future__ import annotations

from pathlib import Path

from benchmarking.page import LOGS, markers
from benchmarking.runs import Outcome
from benchmarking.tables import accuracy_table
from mfslam.types import MfslamError

ALLOWED = 1.10  # of the stored figure
CHECKED = ("mean m", "median m", "mean deg", "median deg")  # the 99 % hang on a handful of relations


def stored_figures(page: Path) -> dict[str, dict[str, str]]:
    """Rows of the accuracy table by log, cells by column. Raises MfslamError where the page has none."""
    try:
        text = page.read_text(encoding="utf-8")
    except OSError as error:
        raise MfslamError(f"{page}: cannot be read: {(error.strerror or str(error)).lower()}") from None
    opening, closing = markers(LOGS)
    head = accuracy_table([])[0]
    rows = [
        [cell.strip() for cell in line.strip("| ").split("|")]
        for line in text.partition(opening)[2].partition(closing)[0].splitlines()
        if line.startswith("|")
    ]
    if head not in rows:
        raise MfslamError(f"{page}: holds no table of {', '.join(head)}; write it with --markdown")
    table = rows[rows.index(head) + 2 :]
    return {row[0]: dict(zip(head, row, strict=True)) for row in table if len(row) == len(head)}


def complaints(outcomes: list[Outcome], page: Path) -> list[str]:
    """One line for every figure that is worse than `ALLOWED` times the stored one, or cannot be had."""
    stored = stored_figures(page)
    out = [f"{o.log}: was not mapped: {o.failure}" for o in outcomes if o.scored and o.failure]
    head, *rows = accuracy_table(outcomes)
    for row in rows:
        now = dict(zip(head, row, strict=True))
        before = stored.get(now["log"])
        if before is None:
            out.append(f"{now['log']}: has no stored figures in {page}; write them with --markdown")
            continue
        if now["relations"] != before["relations"]:
            out.append(
                f"{now['log']}: relations matched are {now['relations']}, stored {before['relations']}"
            )
        out += [
            f"{now['log']}: {column} is {now[column]}, stored {before[column]}"
            for column in CHECKED
            if float(now[column]) > ALLOWED * float(before[column])
        ]
    if not rows and not out:
        out.append("no log here has relations: nothing was checked")
    return out
