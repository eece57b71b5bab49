"""The map: every beam of every scan re-projected from the body's pose at the beam's own instant.

A cell is judged by its hits against the beams that passed through it: what stood there only for a while is
cleared by the beams that passed before and after. Walls are then brought to one cell.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from mfslam.config import Config, MapConfig
from mfslam.deskew import reference_offset_s
from mfslam.kernels import raytrace, walls
from mfslam.types import (
    BoolArray,
    FloatArray,
    IntArray,
    Laser,
    MfslamError,
    OccupancyGrid,
    PointCloud,
    Scan,
)

MAX_CELLS = 400_000_000
_CHUNK_BEAMS = 100_000
_BORDER_CELLS = 2
# a cell with hits that is no wall is free when at least this share of its beams went on through it; fewer
# are noise, and the cell lies behind the wall
_FREE_SHARE = 0.05


def render_map(
    scans: Sequence[Scan], world_T_body: FloatArray, twists: FloatArray, config: Config
) -> tuple[OccupancyGrid, PointCloud]:
    """Occupancy grid and cloud of all hits of ``scans``.

    ``world_T_body`` (S, 3): poses at the scans' reference instants (`deskew.reference_offset_s`).
    ``twists`` (S, 3): body velocities held through each scan, m/s and rad/s; ``config.deskew.mode`` says how
    they are used (eqs. 14-24). Raises MfslamError when the map would have too many cells.
    """
    low_m, high_m = np.full(2, np.inf), np.full(2, -np.inf)
    points: list[FloatArray] = [np.zeros((0, 2))]
    stamps: list[IntArray] = [np.zeros(0, np.int64)]
    sigma_m = 0.0
    for beams in _place_all(scans, world_T_body, twists, config):
        met = beams.kinds == raytrace.HIT
        points.append(beams.ends_m[met])
        stamps.append(beams.stamps_ns[met])
        low_m, high_m = beams.grow_bounds(low_m, high_m)
        sigma_m = max(sigma_m, _blur_sigma_m(beams.laser, config.map))
    cloud = PointCloud(np.concatenate(points), np.concatenate(stamps))
    points.clear()
    stamps.clear()

    origin_m, shape = _frame_of(low_m, high_m, config.map.resolution_m)
    hits, passes = np.zeros(shape, np.uint16), np.zeros(shape, np.uint16)
    for beams in _place_all(scans, world_T_body, twists, config):
        raytrace.trace_beams(
            beams.starts_m.reshape(-1, 2), beams.stops_m.reshape(-1, 2), beams.ends_m.reshape(-1, 2),
            beams.kinds.ravel(), beams.in_range.ravel(), origin_m, config.map.resolution_m, hits, passes,
        )  # fmt: skip
    return OccupancyGrid(origin_m, config.map.resolution_m, judge_cells(hits, passes, sigma_m, config.map)), cloud


# --- beams -------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Beams:
    """Beams of successive scans of one laser in the world: ``starts_m``, ``stops_m`` (end of what they tell
    to be free), ``ends_m`` (C, N, 2); ``kinds``, ``in_range`` (the end counts in the map), ``stamps_ns`` (C, N)."""

    laser: Laser
    stamps_ns: IntArray
    starts_m: FloatArray
    stops_m: FloatArray
    ends_m: FloatArray
    kinds: raytrace.KindArray
    in_range: BoolArray

    def grow_bounds(self, low_m: FloatArray, high_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Corners (2,) that hold these beams too, as far as the map shows them."""
        for part in (self.starts_m.reshape(-1, 2), self.stops_m.reshape(-1, 2), self.ends_m[self.in_range]):
            if len(part):
                low_m, high_m = np.minimum(low_m, part.min(axis=0)), np.maximum(high_m, part.max(axis=0))
        return low_m, high_m


def _place_all(
    scans: Sequence[Scan], world_T_body: FloatArray, twists: FloatArray, config: Config
) -> Iterator[_Beams]:
    """All beams in log order, a few scans of one laser at a time."""
    first = 0
    while first < len(scans):
        laser = scans[first].laser
        end = first + 1
        most = max(1, _CHUNK_BEAMS // max(1, laser.angles_rad.size))
        while end < min(len(scans), first + most) and scans[end].laser is laser:
            end += 1
        yield _place(scans[first:end], world_T_body[first:end], twists[first:end], config)
        first = end


def _place(scans: Sequence[Scan], world_T_body: FloatArray, twists: FloatArray, config: Config) -> _Beams:
    laser = scans[0].laser
    ranges_m = np.stack([scan.ranges_m for scan in scans])
    times_s = laser.offsets_s - reference_offset_s(laser)
    if config.deskew.mode == "range":
        ranges_m = (ranges_m + twists[:, :1] * times_s).astype(np.float32)  # eqs. 19-24
    held = twists if config.deskew.mode == "pose" else np.zeros_like(twists)
    starts = np.empty((*ranges_m.shape, 2))
    stops, ends = np.empty_like(starts), np.empty_like(starts)
    kinds, in_range = np.empty(ranges_m.shape, np.int8), np.empty(ranges_m.shape, np.bool_)
    limits = (laser.range_min_m, laser.range_max_m, config.map.no_return_free_m)
    raytrace.place_beams(
        ranges_m, world_T_body, held, laser.angles_rad, times_s, laser.body_T_laser, limits,
        starts, ends, kinds,
    )  # fmt: skip
    sigma_m = _blur_sigma_m(laser, config.map)
    raytrace.stop_short(starts, ends, kinds, sigma_m, config.map.max_range_m, stops, in_range)
    offsets_ns = np.round(laser.offsets_s * 1e9).astype(np.int64)
    stamps = np.array([scan.stamp_ns for scan in scans], dtype=np.int64)[:, None] + offsets_ns
    return _Beams(laser, stamps, starts, stops, ends, kinds, in_range)


def _blur_sigma_m(laser: Laser, config: MapConfig) -> float:
    """How far a hit lies off its wall, one sigma: the range's noise and what is left of the poses' errors."""
    return math.hypot(laser.range_sigma_m, config.pose_sigma_m)


# --- cells -------------------------------------------------------------------------------------------


def _frame_of(low_m: FloatArray, high_m: FloatArray, resolution_m: float) -> tuple[FloatArray, tuple[int, int]]:
    """Origin, on a whole multiple of the resolution, and (rows, cols) of a grid that holds both corners.

    Raises MfslamError when that is too many cells.
    """
    if not np.isfinite([low_m, high_m]).all():
        low_m = high_m = np.zeros(2)
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


def judge_cells(
    hits: raytrace.CountArray, passes: raytrace.CountArray, sigma_m: float, config: MapConfig
) -> np.ndarray:
    """Occupancy (rows, cols): 100 occupied, 0 free, -1 unknown, of hits and passes per cell.

    ``sigma_m``: spread of the hits across a wall, which is thinned to its ridge.
    """
    share = np.float32(config.occupied_share)
    met = hits > 0
    occupied = (hits >= config.min_hits) & (hits * (1.0 - share) >= passes * share)
    _thin(occupied, hits, sigma_m / config.resolution_m)
    free = passes > 0
    free[met] = passes[met] >= _FREE_SHARE * (hits[met].astype(np.float32) + passes[met])
    occupancy = np.full(hits.shape, -1, np.int8)
    occupancy[free] = 0
    occupancy[occupied] = 100
    return occupancy


def _thin(occupied: BoolArray, hits: raytrace.CountArray, sigma_cells: float) -> None:
    """Leave of each wall the ridge of its hits."""
    cells = np.argwhere(occupied)
    if not len(cells):
        return
    smooth = max(1.0, sigma_cells)
    radius = math.ceil(2.0 * smooth)
    weights = np.exp(-0.5 * (np.arange(-radius, radius + 1) / smooth) ** 2)
    density = walls.smooth_hits(hits, cells, weights)
    flanks = cells[walls.find_flanks(density, cells, max(1, math.ceil(2.5 * sigma_cells)), radius + 1)]
    order = np.argsort(density[flanks[:, 0], flanks[:, 1]], kind="stable")
    walls.thin_walls(occupied, flanks[order])
