"""From scans and poses to the occupancy grid and the cloud of all hits."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from mfslam.config import Config
from mfslam.kernels import glass, raytrace, surfels
from mfslam.mapping.beams import Beams, ScanGroup, ahead, scan_groups
from mfslam.mapping.cells import CellCounts, find_occupied, frame_of, judge_cells
from mfslam.mapping.panes import find_panes
from mfslam.mapping.surface import PATCH_M, Surface
from mfslam.types import Findings, FloatArray, Int8Array, IntArray, OccupancyGrid, PointCloud, Scan

_BRIDGE_M = 0.25  # hits of neighbouring beams on one surface have wall between them, up to this far apart


def render_map(
    scans: Sequence[Scan],
    world_T_body: FloatArray,
    twists: FloatArray,
    config: Config,
    findings: Findings | None = None,
) -> tuple[OccupancyGrid, PointCloud]:
    """Occupancy grid of all beams, and cloud of all hits, of ``scans``.

    ``world_T_body`` (S, 3): poses at the scans' reference instants (`deskew.reference_offset_s`).
    ``twists`` (S, 3): body velocities held through each scan, m/s and rad/s, or (S, 6): those at the reference instants, and
    their change per second; ``config.deskew.mode`` says how
    they are used (eqs. 14-24). ``findings`` is told when the cloud had to be thinned to ``map.max_points``.
    Raises MfslamError when the map would have too many cells.
    """
    if world_T_body.shape != (len(scans), 3) or twists.shape not in ((len(scans), 3), (len(scans), 6)):
        raise ValueError(
            f"expected {len(scans)} poses and twists, got {world_T_body.shape} and {twists.shape}"
        )
    if not (np.isfinite(world_T_body).all() and np.isfinite(twists).all()):
        raise ValueError("poses or twists are not finite")

    def groups() -> Iterator[ScanGroup]:
        return scan_groups(scans, world_T_body, twists, config)

    # one after the other: never the counts of all cells and the cloud of all hits in memory at once
    grid = _render_grid(groups, config)
    total = sum(scan.ranges_m.size for scan in scans)
    return grid, _project_hits(groups(), total, config.map.max_points, findings)


def _render_grid(groups: Callable[[], Iterator[ScanGroup]], config: Config) -> OccupancyGrid:
    surface, bounds_m = _fit_surface(groups())
    resolution_m, sigma_m = config.map.resolution_m, surface.sigma_m
    origin_m, shape = frame_of(bounds_m, resolution_m)
    counts = CellCounts(*(np.zeros(shape, np.uint16) for _ in range(3)))
    stood = _count_beams(groups(), surface, counts, origin_m, resolution_m)
    occupied = find_occupied(counts, config.map)
    panes = find_panes(surface, groups(), occupied, origin_m, resolution_m)
    glass.draw_lines(panes, 0.6 * PATCH_M, origin_m, resolution_m, occupied)
    del surface  # judging takes all the memory that there is
    return OccupancyGrid(origin_m, resolution_m, judge_cells(counts, occupied, sigma_m, config.map, stood))


def _fit_surface(groups: Iterator[ScanGroup]) -> tuple[Surface, FloatArray]:
    """The surface that all scans agree on, and bounds (4,) of all that will be drawn: x_min, y_min, x_max, y_max."""
    surface = Surface()
    bounds_m = np.array([np.inf, np.inf, -np.inf, -np.inf])
    for beams in ahead(groups, lambda group: group.place_for_map(bounds_m)):
        surface.add(beams)
    surface.fit()
    return surface, bounds_m + surface.most_moved_m * np.array([-1.0, -1.0, 1.0, 1.0])


def _count_beams(
    groups: Iterator[ScanGroup],
    surface: Surface,
    counts: CellCounts,
    origin_m: FloatArray,
    resolution_m: float,
) -> IntArray:
    """Add all beams to the counts; row and column (K, 2) of the cells in which the laser stood."""

    def on_surface(numbered: tuple[int, ScanGroup]) -> tuple[Beams, FloatArray, Int8Array]:
        number, group = numbered
        beams = group.place_for_map(np.zeros(4))
        surface.adjust(number, beams)
        stops_m = np.empty_like(beams.starts_m)
        raytrace.stop_short(beams.starts_m, beams.ends_m, beams.kinds, beams.sigma_m, stops_m)
        return beams, stops_m, surface.facings[number]

    stood = [np.zeros((0, 2), np.int64)]
    for beams, stops_m, facings in ahead(enumerate(groups), on_surface):
        stood.append(_cells_of(beams.stood_m(), origin_m, resolution_m))
        _count(beams, stops_m, facings, counts, origin_m, resolution_m)
    return np.concatenate(stood)


def _cells_of(points_m: FloatArray, origin_m: FloatArray, resolution_m: float) -> IntArray:
    """Row and column (K, 2) of points (K, 2)."""
    return np.ascontiguousarray(np.floor((points_m - origin_m) / resolution_m).astype(np.int64)[:, ::-1])


def _count(
    beams: Beams,
    stops_m: FloatArray,
    facings: Int8Array,
    counts: CellCounts,
    origin_m: FloatArray,
    resolution_m: float,
) -> None:
    """Add beams, which leave surely free space at ``stops_m`` (C, N, 2), to the counts of a grid that starts at ``origin_m``."""
    raytrace.trace_beams(
        beams.starts_m.reshape(-1, 2), stops_m.reshape(-1, 2), beams.ends_m.reshape(-1, 2), beams.kinds.ravel(),
        origin_m, resolution_m, counts.hits, counts.passes, counts.nears,
    )  # fmt: skip
    raytrace.bridge_hits(
        beams.ends_m, beams.kinds, facings, surfels.SECTORS, origin_m, resolution_m, _BRIDGE_M, counts.hits
    )


def _project_hits(
    groups: Iterator[ScanGroup], total: int, max_points: int, findings: Findings | None
) -> PointCloud:
    """All hits of ``total`` beams as they were sensed: not moved, none left out but to come down to ``max_points``."""
    keep_every = max(1, math.ceil(total / max_points))
    if keep_every > 1 and findings is not None:
        findings.add(
            "points-thinned",
            f"{total} beams are more than map.max_points: points.ply holds one hit in {keep_every}, the map all",
        )
    # memory is taken as it is filled, not here
    points, stamps = np.empty((total, 2)), np.empty(total, np.int64)
    kept = seen = 0
    for beams in ahead(groups, ScanGroup.place):
        met = np.flatnonzero(beams.kinds == raytrace.HIT)
        chosen = met[-seen % keep_every :: keep_every]
        seen += len(met)
        points[kept : kept + len(chosen)] = beams.ends_m.reshape(-1, 2)[chosen]
        stamps[kept : kept + len(chosen)] = beams.stamps_ns.ravel()[chosen]
        kept += len(chosen)
    return PointCloud(points[:kept], stamps[:kept])
