"""Free space made whole: crumbs taken away, slits between beams filled."""

import numpy as np

from mfslam.kernels.compiling import helper, kernel
from mfslam.types import BoolArray, Int8Array, IntArray


@kernel
def drop_crumbs(free: BoolArray, min_cells: int, min_side: int, kept: IntArray) -> None:
    """Clear connected patches (4 neighbours) of fewer than ``min_cells`` cells, or without any square of ``min_side``
    cells in them; but none that holds one of the ``kept`` cells (K, 2), row and column.

    Joins runs of free cells row by row, so that memory goes with the runs and not with the cells.
    """
    rows, cols = free.shape
    count = 0
    for i in range(rows):
        before = False
        for j in range(cols):
            count += free[i, j] and not before
            before = free[i, j]
    first, last, parent = np.empty(count, np.int32), np.empty(count, np.int32), np.empty(count, np.int32)
    begins = np.empty(rows + 1, np.int64)
    run = 0
    for i in range(rows):
        begins[i] = run
        j = 0
        while j < cols:
            if not free[i, j]:
                j += 1
                continue
            first[run], parent[run] = j, run
            while j < cols and free[i, j]:
                j += 1
            last[run] = j - 1
            run += 1
        if i > 0:
            _join_rows(first, last, parent, begins[i - 1], begins[i], run)
    begins[rows] = run
    cells, side = np.zeros(count, np.int64), np.zeros(count, np.int64)
    above, here = np.zeros(cols + 1, np.int32), np.zeros(cols + 1, np.int32)
    for i in range(rows):
        for j in range(cols + 1):
            here[j] = 0
        for k in range(begins[i], begins[i + 1]):
            root = _root(parent, k)
            cells[root] += last[k] - first[k] + 1
            for j in range(first[k], last[k] + 1):
                # the largest square with its corner here
                here[j + 1] = min(here[j], above[j], above[j + 1]) + 1
                side[root] = max(side[root], here[j + 1])
        above, here = here, above
    for q in range(kept.shape[0]):
        i, j = kept[q, 0], kept[q, 1]
        for k in range(begins[i], begins[i + 1]):
            if first[k] <= j <= last[k]:
                cells[_root(parent, k)] = side[_root(parent, k)] = max(rows, cols) ** 2
    for i in range(rows):
        for k in range(begins[i], begins[i + 1]):
            root = _root(parent, k)
            if cells[root] < min_cells or side[root] < min_side:
                for j in range(first[k], last[k] + 1):
                    free[i, j] = False


@helper
def _join_rows(first: IntArray, last: IntArray, parent: IntArray, above: int, here: int, end: int) -> None:
    """Join each run of a row, from ``here`` on, with those of the row before, from ``above`` on, that it touches."""
    a, b = above, here
    while a < here and b < end:
        if first[a] <= last[b] and first[b] <= last[a]:
            low, high = _root(parent, a), _root(parent, b)
            parent[max(low, high)] = min(low, high)
        if last[a] < last[b]:
            a += 1
        else:
            b += 1


@helper
def _root(parent: IntArray, k: int) -> int:
    while parent[k] != k:
        parent[k] = parent[parent[k]]
        k = parent[k]
    return k


@kernel
def fill_slits(occupancy: Int8Array, between: int, before: int) -> None:
    """Unknown cells (-1) become free (0) in slits along a row or a column: of at most ``between`` cells from free to free,
    where beams fan out, and of at most ``before`` cells from free to occupied, where a wall was thinned."""
    rows, cols = occupancy.shape
    state = np.full((2, cols), -1, np.int64)  # by column: row of the last known cell, and what it is
    for i in range(rows):
        at, what = -1, -1
        for j in range(cols):
            now = occupancy[i, j]
            if now < 0:
                continue
            if what == 0 or now == 0:
                width = between if what == now else before
                if 1 < j - at <= width + 1 and what >= 0:
                    for q in range(at + 1, j):
                        occupancy[i, q] = 0
            at, what = j, now
    for i in range(rows):
        for j in range(cols):
            now = occupancy[i, j]
            if now < 0:
                continue
            at, what = state[0, j], state[1, j]
            if what == 0 or now == 0:
                width = between if what == now else before
                if 1 < i - at <= width + 1 and what >= 0:
                    for q in range(at + 1, i):
                        occupancy[q, j] = 0
            state[0, j], state[1, j] = i, now
