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
    Findings,
    FloatArray,
    Int8Array,
    IntArray,
    MfslamError,
    OccupancyGrid,
    PointCloud,
    Scan,
)

MAX_CELLS = 400_000_000
_CHUNK_BEAMS = 100_000
_BORDER_CELLS = 2
_ALONG_CELLS = 5  # a wall is straight for about this long to either side
_BAND_ROWS = 512  # large grids are judged band by band, for the sake of memory
_MIN_FREE_M2 = 0.05  # smaller pockets of free space are crumbs behind walls and windows


def render_map(
    scans: Sequence[Scan],
    world_T_body: FloatArray,
    twists: FloatArray,
    config: Config,
    findings: Findings | None = None,
) -> tuple[OccupancyGrid, PointCloud]:
    """Occupancy grid of all beams, and cloud of all hits, of ``scans``.

    ``world_T_body`` (S, 3): poses at the scans' reference instants (`deskew.reference_offset_s`).
    ``twists`` (S, 3): body velocities held through each scan, m/s and rad/s; ``config.deskew.mode`` says how
    they are used (eqs. 14-24). ``findings`` is told when the cloud had to be thinned to ``map.max_points``.
    Raises MfslamError when the map would have too many cells.
    """
    if world_T_body.shape != (len(scans), 3) or twists.shape != (len(scans), 3):
        raise ValueError(
            f"expected {len(scans)} poses and twists, got {world_T_body.shape} and {twists.shape}"
        )
    if not (np.isfinite(world_T_body).all() and np.isfinite(twists).all()):
        raise ValueError("poses or twists are not finite")
    # one after the other: never the counts of all cells and the cloud of all hits in memory at once
    grid = _render_grid(scans, world_T_body, twists, config)
    return grid, _project_hits(scans, world_T_body, twists, config, findings)


def _render_grid(
    scans: Sequence[Scan], world_T_body: FloatArray, twists: FloatArray, config: Config
) -> OccupancyGrid:
    resolution_m, max_range_m = config.map.resolution_m, config.map.max_range_m
    bounds_m = np.array([np.inf, np.inf, -np.inf, -np.inf])
    for beams in _place_all(scans, world_T_body, twists, config):
        beams.limit(max_range_m, bounds_m)
    origin_m, shape = _frame_of(bounds_m, resolution_m)
    counts = CellCounts(*(np.zeros(shape, np.uint16) for _ in range(3)))
    sigma_m = 0.0
    for beams in _place_all(scans, world_T_body, twists, config):
        beams.limit(max_range_m, bounds_m)
        beams.trace(counts, origin_m, resolution_m)
        sigma_m = max(sigma_m, beams.sigma_m)
    return OccupancyGrid(origin_m, resolution_m, judge_cells(counts, sigma_m, config.map))


def _project_hits(
    scans: Sequence[Scan],
    world_T_body: FloatArray,
    twists: FloatArray,
    config: Config,
    findings: Findings | None,
) -> PointCloud:
    total = sum(scan.ranges_m.size for scan in scans)
    keep_every = max(1, math.ceil(total / config.map.max_points))
    if keep_every > 1 and findings is not None:
        findings.add(
            "points-thinned",
            f"{total} beams are more than map.max_points: points.ply holds one hit in {keep_every}, the map all",
        )
    # memory is taken as it is filled, not here
    points, stamps = np.empty((total, 2)), np.empty(total, np.int64)
    kept = seen = 0
    for beams in _place_all(scans, world_T_body, twists, config):
        met = np.flatnonzero(beams.kinds == raytrace.HIT)
        chosen = met[-seen % keep_every :: keep_every]
        seen += len(met)
        points[kept : kept + len(chosen)] = beams.ends_m.reshape(-1, 2)[chosen]
        stamps[kept : kept + len(chosen)] = beams.stamps_ns.ravel()[chosen]
        kept += len(chosen)
    return PointCloud(points[:kept], stamps[:kept])


@dataclass(eq=False)
class CellCounts:
    """What the beams say of each cell (rows, cols): ``hits``; ``passes`` that went on well beyond it;
    ``nears``, passes that ended within the blur of a surface there."""

    hits: raytrace.CountArray
    passes: raytrace.CountArray
    nears: raytrace.CountArray


# --- beams -------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Beams:
    """Beams of successive scans of one laser: ``starts_m``, ``ends_m`` (C, N, 2) in the world, ``kinds`` and
    ``stamps_ns`` (C, N). ``sigma_m``: how far an end may lie off its wall, one sigma."""

    stamps_ns: IntArray
    starts_m: FloatArray
    ends_m: FloatArray
    kinds: raytrace.KindArray
    sigma_m: float

    def limit(self, max_range_m: float, bounds_m: FloatArray) -> None:
        """Cut these beams at ``max_range_m`` and widen ``bounds_m`` (4,) to hold them."""
        raytrace.limit_range(self.starts_m, self.ends_m, self.kinds, max_range_m, bounds_m)

    def trace(self, counts: CellCounts, origin_m: FloatArray, resolution_m: float) -> None:
        """Add these beams to the counts of a grid that starts at ``origin_m``."""
        stops = np.empty_like(self.starts_m)
        raytrace.stop_short(self.starts_m, self.ends_m, self.kinds, self.sigma_m, stops)
        raytrace.trace_beams(
            self.starts_m.reshape(-1, 2), stops.reshape(-1, 2), self.ends_m.reshape(-1, 2), self.kinds.ravel(),
            origin_m, resolution_m, counts.hits, counts.passes, counts.nears,
        )  # fmt: skip


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
    ends, kinds = np.empty_like(starts), np.empty(ranges_m.shape, np.int8)
    limits = (laser.range_min_m, laser.range_max_m, config.map.no_return_free_m)
    raytrace.place_beams(
        ranges_m, world_T_body, held, laser.angles_rad, times_s, laser.body_T_laser, limits,
        starts, ends, kinds,
    )  # fmt: skip
    offsets_ns = np.round(laser.offsets_s * 1e9).astype(np.int64)
    stamps = np.array([scan.stamp_ns for scan in scans], dtype=np.int64)[:, None] + offsets_ns
    # noise of the range, and what is left of the poses' errors
    sigma_m = math.hypot(laser.range_sigma_m, config.map.pose_sigma_m)
    return _Beams(stamps, starts, ends, kinds, sigma_m)


# --- cells -------------------------------------------------------------------------------------------


def _frame_of(bounds_m: FloatArray, resolution_m: float) -> tuple[FloatArray, tuple[int, int]]:
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


def judge_cells(counts: CellCounts, sigma_m: float, config: MapConfig) -> Int8Array:
    """Occupancy (rows, cols) of the cells' counts: 100 occupied, 0 free, -1 unknown.

    ``sigma_m``: spread of the hits across a wall, which is thinned to its ridge. ``counts`` is used up:
    what is done with is dropped, since these grids are the largest of a run.
    """
    met = np.nonzero(counts.hits)
    hits, passes, nears = (c[met].astype(np.int64) for c in (counts.hits, counts.passes, counts.nears))
    free = counts.passes > 0
    for top in range(0, len(free), _BAND_ROWS):
        free[top : top + _BAND_ROWS] |= counts.nears[top : top + _BAND_ROWS] > 0
    counts.passes = counts.nears = counts.passes[:0].copy()
    occupied = np.zeros(free.shape, np.bool_)
    occupied[met] = (hits >= config.min_hits) & (hits >= config.occupied_share * (hits + passes))
    _thin(occupied, counts.hits, sigma_m / config.resolution_m)
    free[met] = passes + nears >= hits  # else the hits are noise, and the cell lies behind its wall
    free &= ~occupied
    _drop_crumbs(free, math.ceil(_MIN_FREE_M2 / config.resolution_m**2))
    occupancy = free.view(np.int8)
    occupancy -= 1
    occupancy[occupied] = 100
    return occupancy


def _drop_crumbs(free: BoolArray, min_cells: int) -> None:
    """Clear connected patches of fewer than ``min_cells`` cells."""
    from scipy import ndimage

    rows = free.shape[0]
    # bands overlap by more than a crumb can measure: each crumb lies whole in one of them
    for top in range(0, rows, _BAND_ROWS):
        band = free[top : top + _BAND_ROWS + min_cells]
        labels, n_patches = ndimage.label(band)
        keep = np.bincount(labels.ravel(), minlength=n_patches + 1) >= min_cells
        if top > 0:
            keep[labels[0]] = True
        if top + len(band) < rows:
            keep[labels[-1]] = True
        band &= keep[labels]


def _thin(occupied: BoolArray, hits: raytrace.CountArray, sigma_cells: float) -> None:
    """Leave of each wall the ridge of its hits."""
    cells = np.argwhere(occupied)
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
    walls.thin_walls(occupied, np.concatenate(flanks)[np.argsort(np.concatenate(values), kind="stable")])
