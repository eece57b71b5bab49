"""The map itself: how sharp a cloud of hits is."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from mfslam.types import FloatArray, IntArray

MOST_CELLS_A_POINT = 4  # of the area, to have a count for each


@dataclass(frozen=True, slots=True)
class Crispness:
    """How sharp a cloud of hits is: cells that hold any, and the entropy of the hits over cells.

    Both are lower for a sharper map of the same scans.
    """

    cells: int
    entropy_nats: float

    @property
    def entropy_bits(self) -> float:
        return self.entropy_nats / math.log(2.0)

    def as_json(self) -> dict[str, Any]:
        return {"cells": self.cells, "entropy_nats": self.entropy_nats, "entropy_bits": self.entropy_bits}


def crispness(points_m: FloatArray, resolution_m: float = 0.02) -> Crispness:
    """Crispness of points (P, 2) over cells of ``resolution_m``; entropy is -sum p log p over cells hit."""
    if len(points_m) == 0:
        return Crispness(0, 0.0)
    # one column after the other, in place: clouds are large
    keys = _cells_along(points_m[:, 0], resolution_m)
    rows = _cells_along(points_m[:, 1], resolution_m)
    width, height = int(keys.max()) + 1, int(rows.max()) + 1
    keys *= height
    keys += rows
    if width * height <= MOST_CELLS_A_POINT * len(keys):  # counted three times as fast as sorted
        counts = np.bincount(keys)
        counts = counts[counts > 0]
    else:
        keys.sort()
        starts = np.flatnonzero(np.concatenate([[True], keys[1:] != keys[:-1]]))
        counts = np.diff(starts, append=len(keys))
    share = counts / len(keys)
    return Crispness(len(share), float(-np.sum(share * np.log(share))))


def _cells_along(values_m: FloatArray, resolution_m: float) -> IntArray:
    """Number of the cell that each value (P,) lies in, from 0."""
    cells = np.floor(values_m / resolution_m).astype(np.int64)
    cells -= cells.min()
    return cells
