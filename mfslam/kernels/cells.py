"""A hash grid over oriented points: the nearest-neighbour structure of every registration."""

import math

import numpy as np

from mfslam.kernels.compiling import helper, kernel
from mfslam.types import FloatArray, IntArray

# of every slot: key, first row and the row after the last, (capacity, 3); points sorted by cell, (M, 4)
CellTable = tuple[IntArray, FloatArray]
FREE = np.iinfo(np.int64).min  # key of a slot without cell


@helper
def cell_key(ix: int, iy: int) -> int:
    return (ix << 32) ^ (iy & 0xFFFFFFFF)


@helper
def find_slot(index: IntArray, key: int) -> int:
    """Slot of ``key``, or the free one where it would go."""
    mask = index.shape[0] - 1
    h = key * -7046029254386353131
    h ^= h >> 29
    slot: int = h & mask
    while index[slot, 0] != key and index[slot, 0] != FREE:
        slot = (slot + 1) & mask
    return slot


@kernel
def build_cells(oriented: FloatArray, cell: float) -> CellTable:
    """Hash grid over oriented points (M, 4): rows x, y, nx, ny, which it keeps sorted by cell."""
    m = oriented.shape[0]
    capacity = 16
    while capacity < m // 2:  # a small table stays in the processor's cache
        capacity *= 2
    slots = np.empty(m, np.int64)
    while True:
        index = np.empty((capacity, 3), np.int64)
        for s in range(capacity):
            index[s, 0], index[s, 1], index[s, 2] = FREE, 0, 0
        used = k = 0
        while k < m and 2 * used <= capacity:
            key = cell_key(math.floor(oriented[k, 0] / cell), math.floor(oriented[k, 1] / cell))
            slot = find_slot(index, key)
            used += index[slot, 0] == FREE
            index[slot, 0] = key
            index[slot, 2] += 1
            slots[k] = slot
            k += 1
        if 2 * used <= capacity:
            break
        capacity *= 2
    total = 0
    for s in range(capacity):
        count = index[s, 2]
        index[s, 1] = index[s, 2] = total
        total += count
    rows = np.empty((m, 4))
    for k in range(m):
        at = index[slots[k], 2]
        index[slots[k], 2] += 1
        for u in range(4):
            rows[at, u] = oriented[k, u]
    return index, rows


@kernel
def smooth_surface(table: CellTable, cell: float, radius: float, spacing: float) -> FloatArray:
    """Surface points (K, 4) of a table: thinned to about ``spacing``, each moved along its normal to the
    mean of its like-minded neighbours within ``radius``.

    Nearest-neighbour matching against the raw points of many scans favours the ones whose noise happens
    to lie near the guess; the mean has no such pull.
    """
    index, rows = table
    m = rows.shape[0]
    out = np.empty((m, 4))
    taken = np.zeros(m, np.bool_)
    k = 0
    r2, s2 = radius * radius, spacing * spacing
    for i in range(m):
        if taken[i]:
            continue
        x, y, nx, ny = rows[i, 0], rows[i, 1], rows[i, 2], rows[i, 3]
        oriented = nx != 0.0 or ny != 0.0
        least = 0.85 if oriented else -2.0
        cnt = along = off = sx = sy = 0.0
        y0, y1 = math.floor((y - radius) / cell), math.floor((y + radius) / cell)
        for ix in range(math.floor((x - radius) / cell), math.floor((x + radius) / cell) + 1):
            for iy in range(y0, y1 + 1):
                slot = find_slot(index, cell_key(ix, iy))
                for q in range(index[slot, 1], index[slot, 2]):  # of a free slot: none
                    # weights of 0 and 1 instead of branches, which no processor foresees here
                    dx, dy, ax, ay = rows[q, 0] - x, rows[q, 1] - y, rows[q, 2], rows[q, 3]
                    d2 = dx * dx + dy * dy
                    alike = nx * ax + ny * ay >= least
                    taken[q] |= alike & (d2 <= s2)
                    w = 1.0 if alike & (d2 <= r2) else 0.0
                    cnt += w
                    off += w * (nx * dx + ny * dy)
                    along += w * (nx * dy - ny * dx)
                    sx += w * ax
                    sy += w * ay
        for u in range(4):  # whole rows at once would take seconds to compile
            out[k, u] = rows[i, u]
        if oriented and cnt > 1.0:
            norm = math.sqrt(sx * sx + sy * sy)
            out[k, 0] = x + (off * nx - along * ny) / cnt
            out[k, 1] = y + (off * ny + along * nx) / cnt
            out[k, 2], out[k, 3] = sx / norm, sy / norm
        k += 1
    return out[:k]
