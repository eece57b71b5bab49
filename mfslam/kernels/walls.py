"""Walls one cell thick: the blur of range noise and of poses is taken off a grid of hits.

Noise spreads the hits of a wall over several cells. The ridge of the hits is the wall; the cells on its
flanks are taken off, the weakest first, and never one that holds the wall together.
"""

import math

import numpy as np
import numpy.typing as npt

from mfslam.kernels.compiling import helper, kernel
from mfslam.kernels.raytrace import CountArray
from mfslam.types import BoolArray, Float32Array, FloatArray, IntArray

ByteArray = npt.NDArray[np.uint8]

_FLANK, _SEEN = 2, 3  # marks of flanks, while islands are sought


@kernel
def smooth_hits(
    hits: CountArray, cells: IntArray, weights: FloatArray, top: int, density: Float32Array
) -> None:
    """Hits blurred by the separable kernel ``weights`` (2 R + 1,), at the ``cells`` (K, 2) row, column only.

    ``density``: a band of rows from ``top`` on, zero before.
    """
    reach = weights.shape[0] // 2
    for k in range(cells.shape[0]):
        row, col = cells[k, 0], cells[k, 1]
        total = 0.0
        for i in range(max(0, row - reach), min(hits.shape[0], row + reach + 1)):
            of_row = 0.0
            for j in range(max(0, col - reach), min(hits.shape[1], col + reach + 1)):
                of_row += weights[j - col + reach] * hits[i, j]
            total += weights[i - row + reach] * of_row
        density[row - top, col] = total


@kernel
def find_flanks(
    density: Float32Array, top: int, cells: IntArray, reach: int, window: int, along: int
) -> tuple[BoolArray, Float32Array]:
    """Which ``cells`` (K, 2) have a denser one within ``reach`` cells straight across the wall; their density.

    ``density``: a band of rows from ``top`` on. What is compared is the sum over ``along`` cells to either
    side along the wall, so that a wall on the border of two rows of cells stays in one of them. The
    wall's direction is that of the spread of ``density`` in a window of ``2 window + 1`` cells.
    """
    rows, cols = density.shape
    flank, values = np.zeros(cells.shape[0], np.bool_), np.empty(cells.shape[0], np.float32)
    for k in range(cells.shape[0]):
        row, col = cells[k, 0] - top, cells[k, 1]
        m = sx = sy = sxx = sxy = syy = 0.0
        for i in range(max(0, row - window), min(rows, row + window + 1)):
            for j in range(max(0, col - window), min(cols, col + window + 1)):
                d = density[i, j]
                x, y = float(j - col), float(i - row)
                m += d
                sx += d * x
                sy += d * y
                sxx += d * x * x
                sxy += d * x * y
                syy += d * y * y
        values[k] = density[row, col]
        if m <= 0.0:
            continue
        mx, my = sx / m, sy / m
        cxx, cxy, cyy = sxx / m - mx * mx, sxy / m - mx * my, syy / m - my * my
        across = 0.5 * math.atan2(2.0 * cxy, cxx - cyy) + 0.5 * math.pi
        nx, ny = math.cos(across), math.sin(across)
        scale = 1.0 / max(abs(nx), abs(ny))
        own = _sum_along(density, row, col, nx, ny, along)
        for t in range(-reach, reach + 1):
            i, j = row + round(t * ny * scale), col + round(t * nx * scale)
            if t == 0 or _density_at(density, i, j) == 0.0:
                continue
            other = _sum_along(density, i, j, nx, ny, along)
            # equal ones: the first in reading order stays
            if other > own or (other == own and (i, j) < (row, col)):
                flank[k] = True
                break
        # straight across a slanted wall lies every other diagonal only: the one between is beside it
        if not flank[k] and min(abs(nx), abs(ny)) > 0.4:
            up, right = (1 if ny > 0.0 else -1), (1 if nx > 0.0 else -1)
            for side in (-1, 1):
                flank[k] |= (
                    _density_at(density, row + side * up, col) > values[k]
                    and _density_at(density, row, col + side * right) > values[k]
                )
    return flank, values


@helper
def _density_at(density: Float32Array, row: int, col: int) -> float:
    inside = 0 <= row < density.shape[0] and 0 <= col < density.shape[1]
    return density[row, col] if inside else 0.0


@helper
def _sum_along(density: Float32Array, row: int, col: int, nx: float, ny: float, along: int) -> float:
    """Sum over a piece of wall with the normal (nx, ny), its middle at a cell, less to its ends."""
    scale = 1.0 / max(abs(nx), abs(ny))
    total = 0.0
    for a in range(-along, along + 1):
        at = _density_at(density, row + round(a * nx * scale), col - round(a * ny * scale))
        total += (along + 1 - abs(a)) * at
    return total


@kernel
def thin_walls(occupied: BoolArray, cells: IntArray) -> None:
    """Clear ``cells`` (K, 2) of ``occupied`` in their order, over and over, except those that connect."""
    changed = True
    while changed:
        changed = False
        for k in range(cells.shape[0]):
            row, col = cells[k, 0], cells[k, 1]
            if occupied[row, col] and _is_simple(occupied, row, col):
                occupied[row, col] = False
                changed = True


@kernel
def drop_islands(marks: ByteArray, flanks: IntArray) -> None:
    """Clear what stands apart and is made of ``flanks`` (K, 2) alone: specks beside a wall.

    ``marks`` (rows, cols): 1 for occupied cells, as a boolean grid seen as bytes.
    """
    rows, cols = marks.shape
    for k in range(flanks.shape[0]):
        marks[flanks[k, 0], flanks[k, 1]] = _FLANK
    island = np.empty((flanks.shape[0], 2), np.int64)
    for k in range(flanks.shape[0]):
        if marks[flanks[k, 0], flanks[k, 1]] != _FLANK:
            continue
        marks[flanks[k, 0], flanks[k, 1]] = _SEEN
        island[0, 0], island[0, 1], size, done, apart = flanks[k, 0], flanks[k, 1], 1, 0, True
        while done < size:
            row, col = island[done, 0], island[done, 1]
            done += 1
            for i in range(max(0, row - 1), min(rows, row + 2)):
                for j in range(max(0, col - 1), min(cols, col + 2)):
                    if marks[i, j] == _FLANK:
                        marks[i, j] = _SEEN
                        island[size, 0], island[size, 1] = i, j
                        size += 1
                    elif marks[i, j] == 1:
                        apart = False
        for q in range(size):
            marks[island[q, 0], island[q, 1]] = 0 if apart else 1


@helper
def _is_simple(occupied: BoolArray, row: int, col: int) -> bool:
    """Whether clearing a cell leaves what is connected connected (8 neighbours for occupied, 4 for clear):
    Hilditch's crossing number is one. A lone cell stays."""
    around = ((0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1), (1, 0), (1, 1))
    ring = np.zeros(9, np.bool_)
    for q in range(8):
        i, j = row + around[q][0], col + around[q][1]
        ring[q] = 0 <= i < occupied.shape[0] and 0 <= j < occupied.shape[1] and occupied[i, j]
    ring[8] = ring[0]
    crossings = 0
    for q in range(0, 8, 2):
        if not ring[q] and (ring[q + 1] or ring[q + 2]):
            crossings += 1
    return crossings == 1
