"""When each cell of a finished map was first seen: so that the map grows again when the run is replayed."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from mfslam.types import FloatArray, IntArray, OccupancyGrid

LATEST = 65534
SCANS_AT_ONCE = 64
MOST_CELLS = 40_000_000  # larger maps are shown whole from the start
BEAMS_A_SCAN = 100
STEP_CELLS = 1.0  # along a beam


def first_sights(
    grid: OccupancyGrid, world_T_body: FloatArray, points_m: FloatArray, scan_of_point: IntArray
) -> npt.NDArray[np.uint16] | None:
    """(rows, cols) 1 + the first scan that saw each cell, scaled so that the last scan is `LATEST`.

    ``points_m`` (P, 2): hits in the world, ``scan_of_point`` (P,) in ascending order. Cells that no beam
    towards a hit has crossed take the instant of the nearest one that was crossed. None for huge maps.
    """
    if grid.occupancy.size > MOST_CELLS or not len(points_m):
        return None
    seen = np.zeros(grid.occupancy.shape, dtype=np.uint16)
    scans = len(world_T_body)
    scale = (LATEST - 1) / max(1, scans - 1)
    beams = _some_beams(scan_of_point)
    bounds = np.searchsorted(scan_of_point[beams], np.arange(0, scans + SCANS_AT_ONCE, SCANS_AT_ONCE))
    for first, last in list(pairwise(bounds))[::-1]:  # the earliest writes last
        part = beams[first:last]
        _mark(seen, grid, world_T_body, points_m[part], scan_of_point[part], scale)
    unseen = (seen == 0) & (grid.occupancy >= 0)
    if unseen.any() and seen.any():
        rows, cols = ndimage.distance_transform_edt(seen == 0, return_distances=False, return_indices=True)
        seen[unseen] = seen[rows[unseen], cols[unseen]]
    return seen


def _some_beams(scan: IntArray) -> IntArray:
    """Rows of at most `BEAMS_A_SCAN` points of each scan, evenly: more of them show the same, later."""
    start = np.searchsorted(scan, scan)  # of each point's scan
    count = np.bincount(scan)[scan]
    every = -(-count // BEAMS_A_SCAN)
    return np.flatnonzero((np.arange(len(scan)) - start) % every == 0)


def _mark(
    seen: npt.NDArray[np.uint16],
    grid: OccupancyGrid,
    world_T_body: FloatArray,
    points_m: FloatArray,
    scan: IntArray,
    scale: float,
) -> None:
    """The cells of some beams, latest scan first: of an index that comes twice, numpy keeps what is written last."""
    if not len(points_m):
        return
    points_m, scan = points_m[::-1], scan[::-1]
    start = (world_T_body[scan, :2] - grid.origin_m) / grid.resolution_m
    beam = (points_m - grid.origin_m) / grid.resolution_m - start
    steps = np.ceil(np.hypot(*beam.T) / STEP_CELLS).astype(np.int64).clip(1, 2000)
    at = np.repeat(np.arange(len(beam)), steps)
    share = (np.arange(len(at)) - np.repeat(np.cumsum(steps) - steps, steps) + 1) / steps[at]
    cells = np.floor(start[at] + share[:, None] * beam[at]).astype(np.int64)
    rows, cols = seen.shape
    inside = (cells >= 0).all(axis=1) & (cells[:, 0] < cols) & (cells[:, 1] < rows)
    when = 1 + np.floor(scan[at] * scale).astype(np.uint16)
    seen[cells[inside, 1], cells[inside, 0]] = when[inside]
