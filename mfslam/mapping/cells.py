"""Cells of the map: how many there are, and what the beams' counts make of them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mfslam.config import MapConfig
from mfslam.kernels import patches, raytrace, walls
from mfslam.types import BoolArray, FloatArray, Int8Array, IntArray, MfslamError

MAX_CELLS = 400_000_000
_BORDER_CELLS = 2
_ALONG_CELLS = 5  # a wall is straight for about this long to either side
_BAND_ROWS = 512  # large grids are judged band by band, for the sake of memory
_SPREAD_LEFT = 0.6  # of the hits across a wall, once they were moved onto its surface
_MIN_FREE_M2, _MIN_FREE_M = (
    0.05,
    0.15,
)  # free space smaller or narrower than this is crumbs behind walls and windows
_SLIT_M = 0.1  # unknown slits between beams, as wide as this at most, are free


@dataclass(eq=False)
class CellCounts:
    """What the beams say of each cell (rows, cols): ``hits``; ``passes`` that went on well beyond it;
    ``nears``, passes that ended within the blur of a surface there."""

    hits: raytrace.CountArray
    passes: raytrace.CountArray
    nears: raytrace.CountArray


def frame_of(bounds_m: FloatArray, resolution_m: float) -> tuple[FloatArray, tuple[int, int]]:
    """Origin, on a whole multiple of the resolution, and (rows, cols) of a grid that holds the bounds
    x_min, y_min, x_max, y_max. Raises MfslamError when that is too many cells."""
    low_m, high_m = (bounds_m[:2], bounds_m[2:]) if np.isfinite(bounds_m).all() else np.zeros((2, 2))
    first = np.floor(low_m / resolution_m) - _BORDER_CELLS
    cols, rows = (np.floor(high_m / resolution_m) + 1 + _BORDER_CELLS - first).tolist()
    if cols * rows > MAX_CELLS:
        width_m, height_m = (high_m - low_m).tolist()
        enough = resolution_m * math.sqrt(cols * rows / MAX_CELLS) * 1.05
        digits = -math.floor(math.log10(enough)) + 1
        raise MfslamError(
            f"map.resolution_m: {width_m:.0f} m x {height_m:.0f} m at {resolution_m:g} m are "
            f"{cols * rows / 1e6:.0f} million cells, more than {MAX_CELLS / 1e6:.0f} million: "
            f"set map.resolution_m={round(enough, digits):g} or coarser, or a smaller map.max_range_m"
        )
    return first * resolution_m, (int(rows), int(cols))


def find_occupied(counts: CellCounts, config: MapConfig) -> BoolArray:
    """Cells (rows, cols) that enough of their beams met."""
    met = np.nonzero(counts.hits)
    hits, passes = counts.hits[met].astype(np.int64), counts.passes[met].astype(np.int64)
    occupied = np.zeros(counts.hits.shape, np.bool_)
    occupied[met] = (hits >= config.min_hits) & (hits >= config.occupied_share * (hits + passes))
    return occupied


def judge_cells(
    counts: CellCounts, occupied: BoolArray, sigma_m: float, config: MapConfig, stood: IntArray
) -> Int8Array:
    """Occupancy (rows, cols) of the cells' counts: 100 occupied, 0 free, -1 unknown.

    ``occupied``: walls as they were found, thinned here to their ridge; ``sigma_m``: spread of the raw hits across them.
    ``stood`` (K, 2): row and column of cells in which the laser stood.
    Both ``counts`` and ``occupied`` are used up: these grids are the largest of a run.
    """
    met = np.nonzero(counts.hits)
    hits, passes, nears = (c[met].astype(np.int64) for c in (counts.hits, counts.passes, counts.nears))
    counts.passes |= counts.nears  # whether any beam passed: all that is asked from here on
    counts.nears = counts.nears[:0].copy()
    free = counts.passes > 0
    counts.passes = counts.nears
    _thin(occupied, counts.hits, _SPREAD_LEFT * sigma_m / config.resolution_m)
    free[met] = passes + nears >= hits  # else the hits are noise, and the cell lies behind its wall
    free &= ~occupied
    cell_m = config.resolution_m
    least_cells, least_side = math.ceil(_MIN_FREE_M2 / cell_m**2), math.ceil(_MIN_FREE_M / cell_m)
    patches.drop_crumbs(free, least_cells, least_side, stood)
    occupancy = free.view(np.int8)
    occupancy -= 1
    occupancy[occupied] = 100
    slit = round(_SLIT_M / cell_m)
    patches.fill_slits(occupancy, slit, max(1, slit // 2))
    return occupancy


def _thin(occupied: BoolArray, hits: raytrace.CountArray, sigma_cells: float) -> None:
    """Leave of each wall the ridge of its hits."""
    cells = np.ascontiguousarray(np.argwhere(occupied))
    smooth = max(1.0, sigma_cells)
    radius = math.ceil(2.0 * smooth)
    window = radius + 1
    weights = np.exp(-0.5 * (np.arange(-radius, radius + 1) / smooth) ** 2)
    reach = max(1, math.ceil(2.5 * sigma_cells))
    halo = max(window, reach + _ALONG_CELLS)
    rows, cols = hits.shape
    flanks, values = [cells[:0]], [np.zeros(0, np.float32)]
    for top in range(0, rows, _BAND_ROWS):
        first, last = max(0, top - halo), min(rows, top + _BAND_ROWS + halo)
        around = cells[slice(*np.searchsorted(cells[:, 0], [first, last]))]
        inside = cells[slice(*np.searchsorted(cells[:, 0], [top, top + _BAND_ROWS]))]
        density = np.zeros((last - first, cols), np.float32)
        walls.smooth_hits(hits, around, weights, first, density)
        is_flank, value = walls.find_flanks(density, first, inside, reach, window, _ALONG_CELLS)
        flanks.append(inside[is_flank])
        values.append(value[is_flank])
    weakest_first = np.concatenate(flanks)[np.argsort(np.concatenate(values), kind="stable")]
    walls.thin_walls(occupied, weakest_first)
    left = weakest_first[occupied[weakest_first[:, 0], weakest_first[:, 1]]]
    walls.drop_islands(occupied.view(np.uint8), left)
