"""A uniform grid over what stands still in a world, so that a beam meets only what is on its way."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from mfslam.types import FloatArray, IntArray

CELL_M = 0.5
_MAX_CELLS = 1_000_000  # beyond, cells grow
_SLACK_M = 1e-6  # an item also belongs to cells that it misses by less: no beam slips through by rounding


@dataclass(frozen=True, eq=False)
class Grid:
    """Cells of ``cell_m`` from ``origin_m`` (2,); ``shape`` (2,): columns, rows.

    The items of cell (i, j) are ``items[starts[k]:starts[k + 1]]`` with k = i * rows + j. Item n is segment
    n, or disc n - M where there are M segments.
    """

    origin_m: FloatArray
    cell_m: float
    shape: IntArray
    starts: IntArray
    items: IntArray


def grid_over(segments: FloatArray, circles: FloatArray) -> Grid:
    """The grid of ``segments`` (M, 4) x1 y1 x2 y2 and ``circles`` (C, 3) x y r."""
    low = np.concatenate([segments[:, :2], segments[:, 2:], circles[:, :2] - circles[:, 2:]])
    high = np.concatenate([segments[:, :2], segments[:, 2:], circles[:, :2] + circles[:, 2:]])
    if not len(low):
        return Grid(np.zeros(2), CELL_M, np.ones(2, np.int64), np.zeros(2, np.int64), np.zeros(0, np.int64))
    origin = low.min(axis=0) - 2.0 * _SLACK_M
    extent = high.max(axis=0) - origin + 2.0 * _SLACK_M
    cell = max(CELL_M, math.sqrt(float(np.prod(extent)) / _MAX_CELLS), float(extent.max()) / _MAX_CELLS)
    shape = np.floor(extent / cell).astype(np.int64) + 1
    counts = np.zeros(int(np.prod(shape)) + 1, np.int64)
    _scatter(segments, circles, origin, cell, shape, counts, np.zeros(0, np.int64))
    starts = np.concatenate([[0], np.cumsum(counts[:-1])])
    items = np.empty(int(starts[-1]), np.int64)
    _scatter(segments, circles, origin, cell, shape, starts.copy(), items)
    return Grid(origin, cell, shape, starts, items)


@njit(cache=True, nogil=True)
def _scatter(
    segments: FloatArray,
    circles: FloatArray,
    origin: FloatArray,
    cell: float,
    shape: IntArray,
    places: IntArray,
    items: IntArray,
) -> None:
    """Count the items of every cell in ``places``; or, when ``items`` has room, put them at their places."""
    n_segments = segments.shape[0]
    for n in range(n_segments + circles.shape[0]):
        if n < n_segments:
            x1, y1, x2, y2 = segments[n, 0], segments[n, 1], segments[n, 2], segments[n, 3]
            low_x, high_x = min(x1, x2), max(x1, x2)
        else:
            x1, y1, r = circles[n - n_segments, 0], circles[n - n_segments, 1], circles[n - n_segments, 2]
            x2, y2 = x1, y1
            low_x, high_x = x1 - r, x1 + r
        first = index_in(low_x - _SLACK_M, origin[0], cell, shape[0])
        last = index_in(high_x + _SLACK_M, origin[0], cell, shape[0])
        for i in range(first, last + 1):
            if n < n_segments:  # the part of the segment in this column
                left, right = origin[0] + i * cell - _SLACK_M, origin[0] + (i + 1) * cell + _SLACK_M
                ya, yb = _height(x1, y1, x2, y2, left), _height(x1, y1, x2, y2, right)
                low_y, high_y = min(ya, yb), max(ya, yb)
                if abs(x2 - x1) <= 2.0 * _SLACK_M:
                    low_y, high_y = min(y1, y2), max(y1, y2)
            else:
                low_y, high_y = y1 - r, y1 + r
            bottom = index_in(low_y - _SLACK_M, origin[1], cell, shape[1])
            top = index_in(high_y + _SLACK_M, origin[1], cell, shape[1])
            for j in range(bottom, top + 1):
                k = i * shape[1] + j
                if items.shape[0]:
                    items[places[k]] = n
                places[k] += 1


@njit(cache=True, nogil=True, inline="always")
def index_in(value: float, origin: float, cell: float, count: int) -> int:
    """Cell of one axis, the nearest one for what lies outside."""
    return min(max(math.floor((value - origin) / cell), 0), count - 1)


@njit(cache=True, nogil=True, inline="always")
def _height(x1: float, y1: float, x2: float, y2: float, x: float) -> float:
    """y of the segment at x, or of its nearer end."""
    if x2 == x1:
        return y1
    u = min(max((x - x1) / (x2 - x1), 0.0), 1.0)
    return y1 + u * (y2 - y1)
