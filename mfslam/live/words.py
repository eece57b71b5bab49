"""What the engine and its back end say to each other."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mfslam.config import Config
from mfslam.types import Edge, FloatArray, IntArray, OccupancyGrid


@dataclass(frozen=True)
class Job:
    """First word to the back end. ``folder``: where the map is kept while it grows, if anywhere."""

    config: Config
    folder: Path | None
    map_every_s: float


@dataclass(frozen=True)
class Thin:
    """Keyframes this many times as far apart from here on."""

    spacing: float


@dataclass(frozen=True)
class Wish:
    """Something wanted at once: the map, the graph, or a run folder written."""

    number: int
    what: str  # "map", "graph", "save"
    folder: Path | None = None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Finish:
    """Last word to the back end: solve, draw, and write ``folder`` where there is one."""

    folder: Path | None
    source: Path
    format: str
    findings: list[tuple[str, str, str, int]] = field(default_factory=list)


@dataclass(frozen=True)
class Enough:
    """While it finishes: no further refinement."""


@dataclass(frozen=True, eq=False)
class Corrected:
    """Where the back end believes scan ``number`` to be.

    ``world_T_body`` (3,), ``covariance`` (3, 3) of x, y, yaw in the world's axes; ``keyframes`` (K, 3), ``loops`` (L, 2).
    """

    number: int
    world_T_body: FloatArray
    covariance: FloatArray
    keyframes: FloatArray
    loops: IntArray
    notes: list[str]


@dataclass(frozen=True, eq=False)
class Granted:
    """The answer to a wish: a grid, (keyframes, edges), or None; ``error`` in one line."""

    number: int
    grid: OccupancyGrid | None = None
    graph: tuple[FloatArray, list[Edge]] | None = None
    error: str | None = None


@dataclass(frozen=True, eq=False)
class NewMap:
    """The map as it was drawn beside the mapping."""

    grid: OccupancyGrid


@dataclass(frozen=True)
class Told:
    """A stage of the finish, in words."""

    text: str


@dataclass(frozen=True)
class Memory:
    """Of the back end, MB: when the first scan came, at most until the final solve, and until the end; of a copy at most."""

    first: float
    mapping: float
    most: float
    copies: float


@dataclass(frozen=True, eq=False)
class Finished:
    """The end: `Outcome.summary` and the findings in words, or the error in one line.

    ``stamps_ns`` (S,), ``online`` (S, 3): every scan as the graph had it before the final solve; ``world_T_body`` (S, 3)
    after it. ``grid``: the map.
    """

    summary: dict[str, Any] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    stamps_ns: IntArray | None = None
    online: FloatArray | None = None
    world_T_body: FloatArray | None = None
    grid: OccupancyGrid | None = None
    memory: Memory | None = None
    error: str | None = None
