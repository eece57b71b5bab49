"""Compiled: rays against segments and discs, on a grid."""

import math

import numpy as np
from numba import njit

from drivers.simulator.grid import Grid, grid_over, index_in
from mfslam.types import FloatArray, IntArray


@njit(cache=True, nogil=True, inline="always")
def _ray_segment(
    ox: float, oy: float, dx: float, dy: float, px: float, py: float, ex: float, ey: float, min_cos: float
) -> float:
    """Distance along the ray o + t d to the segment p + u e, or inf; d is a unit vector.

    ``min_cos``: the segment is invisible to rays farther from its normal than this cosine (glass).
    """
    cross = dx * ey - dy * ex
    if cross == 0.0:
        return math.inf
    wx, wy = px - ox, py - oy
    t = (wx * ey - wy * ex) / cross
    u = (wx * dy - wy * dx) / cross
    if t <= 0.0 or u < -1e-12 or u > 1.0 + 1e-12:  # closed ends: no ray slips through a corner
        return math.inf
    if min_cos > 0.0 and cross * cross < min_cos * min_cos * (ex * ex + ey * ey):
        return math.inf
    return t


@njit(cache=True, nogil=True, inline="always")
def _ray_circle(ox: float, oy: float, dx: float, dy: float, cx: float, cy: float, r: float) -> float:
    """Distance along the ray to the near side of a disc, or inf."""
    wx, wy = cx - ox, cy - oy
    along = wx * dx + wy * dy
    across = wx * dy - wy * dx
    inside = r * r - across * across
    if inside < 0.0:
        return math.inf
    t = along - math.sqrt(inside)
    return t if t > 0.0 else math.inf


@njit(cache=True, nogil=True, inline="always")
def _entry(o: float, d: float, low: float, high: float) -> tuple[float, float]:
    """Along a ray o + t d: where it is between ``low`` and ``high``, from t to t (empty: from > to)."""
    if d == 0.0:
        return (0.0, math.inf) if low <= o <= high else (math.inf, 0.0)
    a, b = (low - o) / d, (high - o) / d
    return max(min(a, b), 0.0), max(a, b)


@njit(cache=True, nogil=True, inline="always")
def _crossings(o: float, d: float, i: int, origin: float, cell: float) -> tuple[int, float, float]:
    """Of a ray in cell ``i`` of one axis: direction of its steps, t of the next border, t from border to border."""
    if d > 0.0:
        return 1, (origin + (i + 1) * cell - o) / d, cell / d
    if d < 0.0:
        return -1, (origin + i * cell - o) / d, -cell / d
    return 0, math.inf, math.inf


@njit(cache=True, nogil=True)
def _cast_in_grid(
    ox: float,
    oy: float,
    dx: float,
    dy: float,
    segments: FloatArray,
    min_cos: FloatArray,
    circles: FloatArray,
    grid_origin: FloatArray,
    cell: float,
    shape: IntArray,
    starts: IntArray,
    items: IntArray,
    range_max: float,
) -> tuple[float, int]:
    """Distance to the first standing thing and its number (segments, then circles); inf and -1 for none.

    Walks from cell to cell (Amanatides and Woo 1987) until a hit lies before the border of the cell.
    """
    n_segments = segments.shape[0]
    x0, y0 = grid_origin[0], grid_origin[1]
    enter_x, leave_x = _entry(ox, dx, x0, x0 + shape[0] * cell)
    enter_y, leave_y = _entry(oy, dy, y0, y0 + shape[1] * cell)
    enter, leave = max(enter_x, enter_y), min(leave_x, leave_y, range_max)
    best, what = math.inf, -1
    if enter > leave:
        return best, what
    i = index_in(ox + enter * dx, x0, cell, shape[0])
    j = index_in(oy + enter * dy, y0, cell, shape[1])
    step_i, next_x, per_x = _crossings(ox, dx, i, x0, cell)
    step_j, next_y, per_y = _crossings(oy, dy, j, y0, cell)
    while True:
        k = i * shape[1] + j
        for place in range(starts[k], starts[k + 1]):
            n = items[place]
            if n < n_segments:
                px, py = segments[n, 0], segments[n, 1]
                t = _ray_segment(ox, oy, dx, dy, px, py, segments[n, 2] - px, segments[n, 3] - py, min_cos[n])
            else:
                c = n - n_segments
                t = _ray_circle(ox, oy, dx, dy, circles[c, 0], circles[c, 1], circles[c, 2])
            if t < best:
                best, what = t, n
        border = min(next_x, next_y)
        if best <= border or border > leave:
            return best, what
        if next_x <= next_y:
            i, next_x = i + step_i, next_x + per_x
        else:
            j, next_y = j + step_j, next_y + per_y
        if not (0 <= i < shape[0] and 0 <= j < shape[1]):
            return best, what


@njit(cache=True, nogil=True)
def _cast_all(
    world_T_laser: FloatArray,
    bearings: FloatArray,
    segments: FloatArray,
    min_cos: FloatArray,
    circles: FloatArray,
    grid_origin: FloatArray,
    cell: float,
    shape: IntArray,
    starts: IntArray,
    items: IntArray,
    moving_segments: FloatArray,
    moving_circles: FloatArray,
    range_max: float,
) -> tuple[FloatArray, IntArray]:
    """`cast_and_name`, the grid in its pieces."""
    scans, beams = world_T_laser.shape[0], world_T_laser.shape[1]
    standing, doors = segments.shape[0] + circles.shape[0], moving_segments.shape[2]
    ranges = np.empty((scans, beams))
    hits = np.empty((scans, beams), np.int64)
    for i in range(scans):
        for j in range(beams):
            ox, oy = world_T_laser[i, j, 0], world_T_laser[i, j, 1]
            heading = world_T_laser[i, j, 2] + bearings[j]
            dx, dy = math.cos(heading), math.sin(heading)
            best, what = _cast_in_grid(
                ox, oy, dx, dy, segments, min_cos, circles, grid_origin, cell, shape, starts, items, range_max
            )
            for k in range(doors):
                px, py = moving_segments[i, j, k, 0], moving_segments[i, j, k, 1]
                ex, ey = moving_segments[i, j, k, 2] - px, moving_segments[i, j, k, 3] - py
                t = _ray_segment(ox, oy, dx, dy, px, py, ex, ey, 0.0)
                if t < best:
                    best, what = t, standing + k
            for k in range(moving_circles.shape[2]):
                cx, cy, r = moving_circles[i, j, k, 0], moving_circles[i, j, k, 1], moving_circles[i, j, k, 2]
                t = _ray_circle(ox, oy, dx, dy, cx, cy, r)
                if t < best:
                    best, what = t, standing + doors + k
            if best > range_max:
                best, what = math.inf, -1
            ranges[i, j], hits[i, j] = best, what
    return ranges, hits


def cast_and_name(
    world_T_laser: FloatArray,
    bearings: FloatArray,
    segments: FloatArray,
    min_cos: FloatArray,
    circles: FloatArray,
    moving_segments: FloatArray,
    moving_circles: FloatArray,
    range_max: float,
    grid: Grid,
) -> tuple[FloatArray, IntArray]:
    """`cast_beams` over the grid of segments and circles; and the number of what each beam hit, (S, B).

    Numbers: segments, circles, moving segments, moving circles, in this order; -1: nothing.
    """
    ranges, hits = _cast_all(
        *(world_T_laser, bearings, segments, min_cos, circles),
        *(grid.origin_m, grid.cell_m, grid.shape, grid.starts, grid.items),
        *(moving_segments, moving_circles, range_max),
    )
    return ranges, hits


def cast_beams(
    world_T_laser: FloatArray,
    bearings: FloatArray,
    segments: FloatArray,
    min_cos: FloatArray,
    circles: FloatArray,
    moving_segments: FloatArray,
    moving_circles: FloatArray,
    range_max: float,
) -> FloatArray:
    """True ranges (S, B) of S scans of B beams, inf beyond ``range_max``.

    ``world_T_laser`` (S, B, 3): the laser's pose at the instant of every beam. ``bearings`` (B,).
    ``segments`` (M, 4) x1 y1 x2 y2 with ``min_cos`` (M,); ``circles`` (C, 3) x y r.
    ``moving_segments`` (S, B, D, 4) and ``moving_circles`` (S, B, P, 3): where they are at every beam.
    """
    grid = grid_over(segments, circles)
    still, moving = (segments, min_cos, circles), (moving_segments, moving_circles)
    return cast_and_name(world_T_laser, bearings, *still, *moving, range_max, grid)[0]
