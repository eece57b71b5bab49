"""How good a map is where the world is known exactly: simulated logs, the true surfaces, the true beams.

All shares are over what the beams truly met: a stretch of surface counts as seen where at least three beams (without noise)
met it within 5 cm.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from drivers.simulator.sensing import HIT_KINDS, BeamTruth
from drivers.simulator.world import World
from mfslam.kernels import raytrace
from mfslam.types import BoolArray, FloatArray, IntArray, OccupancyGrid

SEEN_WITHIN_M, SEEN_HITS = 0.05, 3
CORNER_M = 0.25  # thickness and free space are measured farther than this from any other surface
ACROSS_M = 0.15  # how far to either side of a wall cells count as its own


@dataclass(frozen=True, eq=False)
class Surfaces:
    """Points (N,) on what truly stands still in a world, half a cell apart, and what was seen of them.

    ``normals`` (N, 2) unit. ``seen`` (N, 2): from the side of the normal, and from the other one. ``clear``: no other
    surface near. ``glass``: of glass.
    """

    points_m: FloatArray
    normals: FloatArray
    seen: BoolArray
    clear: BoolArray
    glass: BoolArray


@dataclass(frozen=True, eq=False)
class Truth:
    """Surfaces, true beams (B, 2) from ``starts_m`` to ``ends_m`` in the map's frame, and what was in their way."""

    surfaces: Surfaces
    starts_m: FloatArray
    ends_m: FloatArray
    kinds: raytrace.KindArray


@dataclass(frozen=True, slots=True)
class Quality:
    """What is right and wrong with a map; all but the counts are shares, of 1.

    ``found``: seen stretches of wall with an occupied cell within 1.5 cells. ``glass_found``: the same for glass.
    ``ghosts``: occupied cells with no true surface within 1.5 cells. ``far_ghosts``: none within 10 cm, a count.
    ``thickness_cells``: occupied cells across a wall, in the mean. ``one_cell``: stretches of wall with exactly one.
    ``free_to_wall``: stretches of wall with free space right before the wall's cell, on the side that was seen.
    ``leaks``: stretches of wall seen from one side only with free space that no true beam came near within 15 cm behind. ``false_free``:
    free cells that no true beam came near. ``unfilled``: cells that true beams crossed and that are unknown.
    ``error_m``: distance of occupied cells' centres from the nearest true surface, mean of those within 10 cm.
    """

    found: float
    glass_found: float
    ghosts: float
    far_ghosts: int
    thickness_cells: float
    one_cell: float
    free_to_wall: float
    leaks: float
    false_free: float
    unfilled: float
    error_m: float
    occupied: int


def true_surfaces(
    world: World, beams: BeamTruth, angles_rad: FloatArray, spacing_m: float, yaw_rad: float = 0.0
) -> Truth:
    """The truth behind a log, turned by ``yaw_rad`` about the origin: walls need not follow the cells."""
    heading = beams.world_T_laser[..., 2] + angles_rad
    directions = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    starts = beams.world_T_laser[..., :2]
    met = np.isfinite(beams.ranges_m)
    ends = starts + np.where(met, beams.ranges_m, 0.0)[..., None] * directions
    stands = met & (beams.hits != HIT_KINDS.index("person")) & (beams.hits != HIT_KINDS.index("door"))
    points, normals, glass, owner = _sample(world, spacing_m)
    seen = _seen_sides(points, normals, ends[stands], directions[stands])
    clear = _clear(points, normals, owner)
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    turn = np.array([[c, s], [-s, c]])
    kinds = (
        np.where(stands, raytrace.HIT, np.where(met, raytrace.FREE, raytrace.SILENT)).astype(np.int8).ravel()
    )
    return Truth(
        Surfaces(points @ turn, normals @ turn, seen, clear, glass),
        np.ascontiguousarray((starts @ turn).reshape(-1, 2)),
        np.ascontiguousarray((ends @ turn).reshape(-1, 2)),
        kinds,
    )


def _sample(world: World, spacing_m: float) -> tuple[FloatArray, FloatArray, BoolArray, IntArray]:
    """Points, normals, whether glass, and number of what they lie on."""
    points, normals, glass, owner = [], [], [], []
    for k, (x1, y1, x2, y2) in enumerate(world.segments):
        length = math.hypot(x2 - x1, y2 - y1)
        n = max(1, round(length / spacing_m))
        along = ((np.arange(n) + 0.5) / n)[:, None]
        points.append(np.array([x1, y1]) + along * np.array([x2 - x1, y2 - y1]))
        normals.append(np.tile([(y1 - y2) / length, (x2 - x1) / length], (n, 1)))
        glass.append(np.full(n, world.min_cos[k] > 0.0))
        owner.append(np.full(n, k))
    for k, (x, y, radius) in enumerate(world.circles):
        n = max(8, round(2.0 * math.pi * radius / spacing_m))
        angle = 2.0 * math.pi * np.arange(n) / n
        out = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        points.append(np.array([x, y]) + radius * out)
        normals.append(out)
        glass.append(np.zeros(n, np.bool_))
        owner.append(np.full(n, len(world.segments) + k))
    return np.concatenate(points), np.concatenate(normals), np.concatenate(glass), np.concatenate(owner)


def _seen_sides(
    points: FloatArray, normals: FloatArray, hits: FloatArray, directions: FloatArray
) -> BoolArray:
    """(N, 2) whether enough hits near each point came from the side of its normal, and from the other."""
    from scipy.spatial import cKDTree

    near = cKDTree(points)
    count = np.zeros((len(points), 2), np.int64)
    for part in range(0, len(hits), 200_000):
        some, ways = hits[part : part + 200_000], directions[part : part + 200_000]
        found = near.query(some, k=8, distance_upper_bound=SEEN_WITHIN_M)
        distance, index = np.asarray(found[0]), np.asarray(found[1])
        for column in range(8):
            ok = np.isfinite(distance[:, column])
            i = index[ok, column]
            facing = np.einsum("ij,ij->i", normals[i], ways[ok])
            np.add.at(count[:, 0], i[facing < -0.05], 1)
            np.add.at(count[:, 1], i[facing > 0.05], 1)
    return count >= SEEN_HITS


def _clear(points: FloatArray, normals: FloatArray, owner: IntArray) -> BoolArray:
    """Points with nothing near but what lies on the same line."""
    from scipy.spatial import cKDTree

    out = np.ones(len(points), np.bool_)
    tree = cKDTree(points)
    for k, near in enumerate(tree.query_ball_point(points, CORNER_M)):
        i = np.asarray(near)
        off = np.abs((points[i] - points[k]) @ normals[k])
        out[k] = not np.any((off > 0.01) & (owner[i] != owner[k]))
    return out


def measure_map(grid: OccupancyGrid, truth: Truth) -> Quality:
    """Compare a map, in the frame of the truth, with what truly stands and was seen."""
    from scipy.spatial import cKDTree

    surfaces, cell = truth.surfaces, grid.resolution_m
    occupied = grid.occupancy == 100
    centres = grid.origin_m + cell * (np.argwhere(occupied)[:, ::-1] + 0.5)
    seen = surfaces.seen.any(axis=1)
    off_truth = np.asarray(cKDTree(surfaces.points_m).query(centres)[0])
    off_map = np.asarray(cKDTree(centres).query(surfaces.points_m)[0])
    wall, glass = seen & ~surfaces.glass, seen & surfaces.glass
    visible = _visible(grid, truth)
    free = grid.occupancy == 0
    near_visible = _grown(visible)
    thickness, before, behind = _across(grid, surfaces, free & ~near_visible)
    met = seen & surfaces.clear & (thickness > 0)
    one_sided = met & (surfaces.seen.sum(axis=1) == 1)
    sides = surfaces.seen[met]
    return Quality(
        found=_share(off_map[wall] <= 1.5 * cell),
        glass_found=_share(off_map[glass] <= 1.5 * cell),
        ghosts=_share(off_truth > 1.5 * cell),
        far_ghosts=int(np.count_nonzero(off_truth > 0.1)),
        thickness_cells=float(np.mean(thickness[met])),
        one_cell=_share(thickness[met] == 1),
        free_to_wall=_share(before[met][sides]),
        leaks=_share(np.where(surfaces.seen[one_sided, 0], behind[one_sided, 0], behind[one_sided, 1])),
        false_free=_ratio(free & ~near_visible, free),
        unfilled=_ratio(visible & (grid.occupancy < 0), visible),
        error_m=float(np.mean(off_truth[off_truth < 0.1])),
        occupied=len(centres),
    )


def _share(true: BoolArray) -> float:
    return float(np.mean(true)) if len(true) else math.nan


def _ratio(some: BoolArray, of_all: BoolArray) -> float:
    return float(np.count_nonzero(some)) / max(1, int(np.count_nonzero(of_all)))


def _across(
    grid: OccupancyGrid, surfaces: Surfaces, false_free: BoolArray
) -> tuple[IntArray, BoolArray, BoolArray]:
    """Along the column or row that crosses each surface most directly: occupied cells; whether the cell right before
    the first of them is free, (N, 2) for either side; whether any within `ACROSS_M` behind the last one is wrongly so."""
    cell = grid.resolution_m
    reach = math.ceil(ACROSS_M / cell)
    steep = np.abs(surfaces.normals[:, 1]) >= np.abs(surfaces.normals[:, 0])
    step = np.where(steep, np.sign(surfaces.normals[:, 1]), np.sign(surfaces.normals[:, 0])).astype(np.int64)
    col, row = np.floor((surfaces.points_m - grid.origin_m) / cell).astype(np.int64).T
    rows, cols = grid.occupancy.shape
    offsets = np.arange(-2 * reach, 2 * reach + 1)
    i = np.clip(row[:, None] + np.where(steep, step, 0)[:, None] * offsets, 0, rows - 1)
    j = np.clip(col[:, None] + np.where(steep, 0, step)[:, None] * offsets, 0, cols - 1)
    values = grid.occupancy[i, j]  # from behind the normal to before it
    wrong = false_free[i, j]
    own = (values == 100) & (np.abs(offsets) <= reach)
    count = own.sum(axis=1)
    n, width = values.shape
    first, last = np.argmax(own, axis=1), width - 1 - np.argmax(own[:, ::-1], axis=1)
    at = np.arange(n)
    before = np.stack(
        [values[at, np.minimum(last + 1, width - 1)] == 0, values[at, np.maximum(first - 1, 0)] == 0], axis=1
    )
    index = np.arange(width)
    beyond_last = (index > last[:, None]) & (index <= last[:, None] + reach)
    beyond_first = (index < first[:, None]) & (index >= first[:, None] - reach)
    behind = np.stack([(beyond_first & wrong).any(axis=1), (beyond_last & wrong).any(axis=1)], axis=1)
    return count, before, behind


def _visible(grid: OccupancyGrid, truth: Truth) -> BoolArray:
    """Cells that true beams crossed before the one in which they ended."""
    counts = [np.zeros(grid.occupancy.shape, np.uint16) for _ in range(3)]
    kinds = truth.kinds.copy()
    high = grid.origin_m + grid.resolution_m * (np.array(grid.occupancy.shape[::-1]) - 1)
    for p in (truth.starts_m, truth.ends_m):
        kinds[~np.all((p > grid.origin_m + grid.resolution_m) & (p < high), axis=1)] = raytrace.SILENT
    raytrace.trace_beams(
        truth.starts_m, truth.ends_m, truth.ends_m, kinds, grid.origin_m, grid.resolution_m, *counts
    )
    crossed: BoolArray = (counts[1] > 0) & (counts[0] == 0)
    return crossed


def _grown(cells: BoolArray) -> BoolArray:
    from scipy import ndimage

    grown: BoolArray = ndimage.binary_dilation(cells, np.ones((3, 3), np.bool_))
    return grown


def picture(grid: OccupancyGrid, truth: Truth) -> npt.NDArray[np.uint8]:
    """The map in colours (rows, cols, 3), top row first, with what is wrong about it: true surface without a cell red, true
    glass without one light blue, cells without a surface blue, free space that no beam came near green."""
    from scipy.spatial import cKDTree

    surfaces, cell = truth.surfaces, grid.resolution_m
    image = np.full((*grid.occupancy.shape, 3), 190, np.uint8)
    free = grid.occupancy == 0
    image[free] = 255
    image[free & ~_grown(_visible(grid, truth))] = (110, 230, 110)
    occupied = np.argwhere(grid.occupancy == 100)
    centres = grid.origin_m + cell * (occupied[:, ::-1] + 0.5)
    seen = surfaces.seen.any(axis=1)
    missed = seen & (np.asarray(cKDTree(centres).query(surfaces.points_m)[0]) > 1.5 * cell)
    at = np.floor((surfaces.points_m - grid.origin_m) / cell).astype(np.int64)
    missed &= np.all((at >= 0) & (at < np.array(grid.occupancy.shape)[::-1]), axis=1)
    image[at[missed, 1], at[missed, 0]] = np.where(surfaces.glass[missed, None], (0, 190, 255), (230, 0, 0))
    ghost = np.asarray(cKDTree(surfaces.points_m).query(centres)[0]) > 1.5 * cell
    image[occupied[:, 0], occupied[:, 1]] = np.where(ghost[:, None], (0, 0, 255), (0, 0, 0))
    return np.ascontiguousarray(image[::-1])
