"""What every part of the reproduction hands over to the page."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Effort:
    """How much of an experiment is run. ``quick``: the short version that the tests run (few seconds per
    section, same code, coarser sampling). ``jobs``: processes at the same time. ``figures``: the folder
    where figures are written; None draws none."""

    quick: bool = False
    jobs: int = 1
    figures: Path | None = None


@dataclass(frozen=True)
class Claim:
    """One line of the table: what the paper (or the bar) says, what we measured, whether it holds, why."""

    paper: str
    ours: str
    holds: bool
    why: str


@dataclass
class Section:
    """``body``: markdown below the title; figures are referred to by their file name alone.
    ``measured``: every number behind it, JSON-able."""

    title: str
    body: str
    claims: list[Claim] = field(default_factory=list)
    measured: dict[str, Any] = field(default_factory=dict)
