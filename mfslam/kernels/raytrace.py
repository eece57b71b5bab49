"""Every beam of every scan into a grid of hits and passes."""

import math

import numpy as np
import numpy.typing as npt
from numba import njit

from mfslam.types import BoolArray, Float32Array, FloatArray

CountArray = npt.NDArray[np.uint16]
KindArray = npt.NDArray[np.int8]

SILENT, FREE, HIT = 0, 1, 2  # a beam that says nothing, met nothing, met something
FULL = np.iinfo(np.uint16).max


@njit(cache=True, nogil=True)
def place_beams(
    ranges: Float32Array,
    poses: FloatArray,
    twists: FloatArray,
    angles: FloatArray,
    times: FloatArray,
    mount: FloatArray,
    limits: tuple[float, float, float],
    starts: FloatArray,
    ends: FloatArray,
    kinds: KindArray,
) -> None:
    """Start and end points of the beams of scans (C, N) in the world, each from the body's pose at its time.

    ``poses``, ``twists`` (C, 3): of the body at the scans' reference instants, and held through each.
    ``times`` (N,): instants of the beams from the reference, s. Eqs. 16-18 on the exact arc, with the mount
    in between. ``limits``: shortest and longest range of a hit, and how far a beam without return is free.
    Fills ``starts``, ``ends`` (C, N, 2) and ``kinds`` (C, N).
    """
    range_min, range_max, no_return = limits
    n = ranges.shape[1]
    cos_beam, sin_beam = np.cos(angles + mount[2]), np.sin(angles + mount[2])
    for k in range(ranges.shape[0]):
        x, y, theta = poses[k, 0], poses[k, 1], poses[k, 2]
        c, s = math.cos(theta), math.sin(theta)
        vx, vy, w = twists[k, 0], twists[k, 1], twists[k, 2]
        moving = vx != 0.0 or vy != 0.0 or w != 0.0
        for j in range(n):
            r = float(ranges[k, j])
            if range_min <= r < range_max:
                kinds[k, j] = HIT
            elif r >= range_max and no_return > 0.0:
                kinds[k, j] = FREE
                r = no_return
            else:
                kinds[k, j] = SILENT
                r = 0.0
            if moving:
                # the chord of the arc points along the heading halfway
                half = 0.5 * w * times[j]
                chord = times[j] * (math.sin(half) / half if abs(half) > 1e-9 else 1.0)
                c, s = math.cos(theta + half), math.sin(theta + half)
                x, y = poses[k, 0] + chord * (c * vx - s * vy), poses[k, 1] + chord * (s * vx + c * vy)
                c, s = math.cos(theta + 2.0 * half), math.sin(theta + 2.0 * half)
            starts[k, j, 0] = x + c * mount[0] - s * mount[1]
            starts[k, j, 1] = y + s * mount[0] + c * mount[1]
            ends[k, j, 0] = starts[k, j, 0] + r * (c * cos_beam[j] - s * sin_beam[j])
            ends[k, j, 1] = starts[k, j, 1] + r * (s * cos_beam[j] + c * sin_beam[j])


@njit(cache=True, nogil=True)
def stop_short(
    starts: FloatArray,
    ends: FloatArray,
    kinds: KindArray,
    sigma: float,
    max_range: float,
    stops: FloatArray,
    hit: BoolArray,
) -> None:
    """Where each beam (C, N) stops to tell free space: two sigmas off the surface that it met.

    A beam that grazes a wall runs along inside the wall's blur before it ends, and would clear the wall
    that others have found: the angle to the surface, by the neighbouring beams, says how far before its
    end it must stop. Beyond ``max_range`` nothing is told: ``hit`` holds for nearer ends only.
    """
    n = ends.shape[1]
    gap = 2.0 * sigma
    for k in range(ends.shape[0]):
        for j in range(n):
            dx, dy = ends[k, j, 0] - starts[k, j, 0], ends[k, j, 1] - starts[k, j, 1]
            length = math.sqrt(dx * dx + dy * dy)
            reach = min(length, max_range)
            hit[k, j] = kinds[k, j] == HIT and length <= max_range
            if hit[k, j]:
                sine = 0.0
                for side in (-1, 1):
                    sine = max(sine, _sine_to_surface(ends[k], kinds[k], j, side, dx, dy, length, sigma))
                if sine == 0.0:
                    sine = 1.0
                reach -= min(gap / max(sine, 1e-3), max(gap, 0.5 * length))
            share = max(0.0, reach / length) if length > 0.0 else 0.0
            stops[k, j, 0] = starts[k, j, 0] + share * dx
            stops[k, j, 1] = starts[k, j, 1] + share * dy


@njit(cache=True, nogil=True, inline="always")
def _sine_to_surface(
    ends: FloatArray, kinds: KindArray, j: int, side: int, dx: float, dy: float, length: float, sigma: float
) -> float:
    """Sine of the angle between a beam (dx, dy) and the surface towards the first neighbour that is far
    enough for the noise not to matter; 0 where there is none."""
    for step in range(1, 9):
        q = j + side * step
        if q < 0 or q >= ends.shape[0]:
            break
        if kinds[q] != HIT:
            continue
        tx, ty = ends[q, 0] - ends[j, 0], ends[q, 1] - ends[j, 1]
        spacing = math.sqrt(tx * tx + ty * ty)
        if spacing > 5.0 * sigma:
            return abs(dx * ty - dy * tx) / (length * spacing)
    return 0.0


@njit(cache=True, nogil=True)
def trace_beams(
    starts: FloatArray,
    stops: FloatArray,
    ends: FloatArray,
    kinds: KindArray,
    hit: BoolArray,
    origin: FloatArray,
    cell: float,
    hits: CountArray,
    passes: CountArray,
) -> None:
    """Count for each beam (B, 2) one pass in every cell from its start to its stop, and one hit at its end.

    Walks the grid cell by cell (Amanatides and Woo, A fast voxel traversal algorithm, 1987). The cell of a
    hit gets no pass of the same beam. Counts that would run over are halved, both of the cell, so that their
    ratio stays. The grids (rows, cols) must hold every point.
    """
    for b in range(starts.shape[0]):
        if kinds[b] == SILENT:
            continue
        x0, y0 = (starts[b, 0] - origin[0]) / cell, (starts[b, 1] - origin[1]) / cell
        x1, y1 = (stops[b, 0] - origin[0]) / cell, (stops[b, 1] - origin[1]) / cell
        ix, iy = int(x0), int(y0)
        stop_x, stop_y = int(x1), int(y1)
        end_x, end_y = int((ends[b, 0] - origin[0]) / cell), int((ends[b, 1] - origin[1]) / cell)
        dx, dy = x1 - x0, y1 - y0
        step_x, step_y = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
        tdx = abs(1.0 / dx) if dx != 0.0 else np.inf
        tdy = abs(1.0 / dy) if dy != 0.0 else np.inf
        tx = (ix + 1 - x0 if dx > 0 else x0 - ix) * tdx if dx != 0.0 else np.inf
        ty = (iy + 1 - y0 if dy > 0 else y0 - iy) * tdy if dy != 0.0 else np.inf
        for _ in range(abs(stop_x - ix) + abs(stop_y - iy)):
            _count(passes, hits, iy, ix)
            # on a tie or a rounding error never walk past the last column or row
            if iy == stop_y or (tx < ty and ix != stop_x):
                tx += tdx
                ix += step_x
            else:
                ty += tdy
                iy += step_y
        if not hit[b]:
            _count(passes, hits, iy, ix)
        else:
            if ix != end_x or iy != end_y:
                _count(passes, hits, iy, ix)
            _count(hits, passes, end_y, end_x)


@njit(cache=True, nogil=True, inline="always")
def _count(counts: CountArray, others: CountArray, row: int, col: int) -> None:
    if counts[row, col] == FULL:
        counts[row, col] >>= 1
        others[row, col] >>= 1
    counts[row, col] += 1
