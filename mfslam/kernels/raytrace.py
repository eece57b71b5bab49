"""Every beam of every scan into a grid of hits and passes."""

import math

import numpy as np
import numpy.typing as npt

from mfslam.kernels.compiling import helper, kernel
from mfslam.kernels.poses import chord_and_cosine
from mfslam.types import Float32Array, FloatArray, Int8Array

CountArray = npt.NDArray[np.uint16]
KindArray = npt.NDArray[np.int8]

SILENT, FREE, HIT = 0, 1, 2  # a beam that says nothing, met nothing, met something
FULL = np.iinfo(np.uint16).max


@kernel
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

    ``poses`` (C, 3): of the body at the scans' reference instants; ``twists`` (C, 6): there, and their change per second.
    ``times`` (N,): instants of the beams from the reference, s. Eqs. 16-18 on the exact arc, with the mount
    in between. ``limits``: shortest and longest range of a hit, and how far a beam without return is free.
    Fills ``starts``, ``ends`` (C, N, 2) and ``kinds`` (C, N).
    """
    range_min, range_max, no_return = limits
    n = ranges.shape[1]
    cos_beam, sin_beam = np.cos(angles + mount[2]), np.sin(angles + mount[2])
    for k in range(ranges.shape[0]):
        x, y = poses[k, 0], poses[k, 1]
        cos_yaw, sin_yaw = math.cos(poses[k, 2]), math.sin(poses[k, 2])
        c, s = cos_yaw, sin_yaw
        moving = twists[k].any()
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
                # the mean twist until then; the chord of its arc points along the heading halfway
                ahead = 0.5 * times[j]
                vx, vy = twists[k, 0] + ahead * twists[k, 3], twists[k, 1] + ahead * twists[k, 4]
                half = ahead * (twists[k, 2] + ahead * twists[k, 5])
                chord, turn_c = chord_and_cosine(half)
                turn_s, chord = half * chord, times[j] * chord
                c, s = cos_yaw * turn_c - sin_yaw * turn_s, sin_yaw * turn_c + cos_yaw * turn_s
                x, y = poses[k, 0] + chord * (c * vx - s * vy), poses[k, 1] + chord * (s * vx + c * vy)
                c, s = c * turn_c - s * turn_s, s * turn_c + c * turn_s
            starts[k, j, 0] = x + c * mount[0] - s * mount[1]
            starts[k, j, 1] = y + s * mount[0] + c * mount[1]
            ends[k, j, 0] = starts[k, j, 0] + r * (c * cos_beam[j] - s * sin_beam[j])
            ends[k, j, 1] = starts[k, j, 1] + r * (s * cos_beam[j] + c * sin_beam[j])


@kernel
def drop_mixed(
    ranges: Float32Array,
    starts: FloatArray,
    ends: FloatArray,
    kinds: KindArray,
    sigma: float,
    beam_step: float,
) -> None:
    """Hits of beams (C, N) that met an edge, and tell a range between what is before and what is behind it, where
    nothing is: they become free space up to what is before it.

    Such a hit lies between its neighbours' ranges and on neither of their surfaces, along which the inverse of the range
    is linear in the angle.
    """
    n = ranges.shape[1]
    for k in range(ranges.shape[0]):
        for j in range(1, n - 1):
            if kinds[k, j] != HIT:
                continue
            r, left, right = ranges[k, j], ranges[k, j - 1], ranges[k, j + 1]
            near, far = min(left, right), max(left, right)
            # of a neighbour that says nothing (NaN), nothing follows
            apart = 4.0 * sigma + 2.0 * beam_step * r
            if not (near + apart < r < far - apart):
                continue
            if _on_line(ranges[k], j, -1, sigma) or _on_line(ranges[k], j, 1, sigma):
                continue
            share = max(0.0, near - 3.0 * sigma) / r
            kinds[k, j] = FREE
            for u in range(2):
                ends[k, j, u] = starts[k, j, u] + share * (ends[k, j, u] - starts[k, j, u])


@helper
def _on_line(ranges: Float32Array, j: int, side: int, sigma: float) -> bool:
    """Whether a range goes on along the line of the two beside it."""
    if not 0 <= j + 2 * side < ranges.shape[0]:
        return False
    r, r1, r2 = ranges[j], ranges[j + side], ranges[j + 2 * side]
    if not (r1 > 0.0 and r2 > 0.0):
        return False
    inverse = 2.0 / r1 - 1.0 / r2
    # what noise of the two makes of the prediction
    loose = 3.0 * sigma * r * r * (2.0 / (r1 * r1) + 1.0 / (r2 * r2)) + 3.0 * sigma
    on_line: bool = inverse > 0.0 and abs(1.0 / inverse - r) < loose
    return on_line


@kernel
def limit_range(
    starts: FloatArray, ends: FloatArray, kinds: KindArray, max_range: float, bounds: FloatArray
) -> None:
    """Cut beams (C, N) at ``max_range``: beyond it they tell free space only. Widen ``bounds`` (4,), x_min,
    y_min, x_max, y_max, to hold them."""
    for k in range(ends.shape[0]):
        for j in range(ends.shape[1]):
            if kinds[k, j] == SILENT:
                continue
            x, y = starts[k, j, 0], starts[k, j, 1]
            dx, dy = ends[k, j, 0] - x, ends[k, j, 1] - y
            length = math.sqrt(dx * dx + dy * dy)
            if length > max_range:
                ends[k, j, 0], ends[k, j, 1] = x + max_range / length * dx, y + max_range / length * dy
                kinds[k, j] = FREE
            bounds[0], bounds[1] = min(bounds[0], x, ends[k, j, 0]), min(bounds[1], y, ends[k, j, 1])
            bounds[2], bounds[3] = max(bounds[2], x, ends[k, j, 0]), max(bounds[3], y, ends[k, j, 1])


@kernel
def stop_short(
    starts: FloatArray, ends: FloatArray, kinds: KindArray, sigma: float, stops: FloatArray
) -> None:
    """Where each beam (C, N) leaves space that is surely free: two sigmas off the surface that it met.

    A beam that grazes a wall runs along inside the wall's blur before it ends, and would clear the wall
    that others have found: the angle to the surface, by the neighbouring beams, says how far before its
    end it must stop. Fills ``stops`` (C, N, 2).
    """
    gap = 2.0 * sigma
    for k in range(ends.shape[0]):
        for j in range(ends.shape[1]):
            dx, dy = ends[k, j, 0] - starts[k, j, 0], ends[k, j, 1] - starts[k, j, 1]
            length = math.sqrt(dx * dx + dy * dy)
            share = 1.0
            if kinds[k, j] == HIT and length > 0.0:
                sine = max(
                    _sine_to_surface(ends[k], kinds[k], j, -1, dx, dy, length, sigma),
                    _sine_to_surface(ends[k], kinds[k], j, 1, dx, dy, length, sigma),
                )
                short = gap if sine < 0.0 else min(gap / max(sine, 1e-3), max(gap, 0.5 * length))
                share = max(0.0, 1.0 - short / length)
            stops[k, j, 0] = starts[k, j, 0] + share * dx
            stops[k, j, 1] = starts[k, j, 1] + share * dy


@helper
def _sine_to_surface(
    ends: FloatArray, kinds: KindArray, j: int, side: int, dx: float, dy: float, length: float, sigma: float
) -> float:
    """Sine of the angle between a beam (dx, dy) and the surface towards the first neighbour that is far
    enough for the noise not to matter; -1 where there is none."""
    for step in range(1, 9):
        q = j + side * step
        if q < 0 or q >= ends.shape[0]:
            break
        if kinds[q] != HIT:
            continue
        tx, ty = ends[q, 0] - ends[j, 0], ends[q, 1] - ends[j, 1]
        square = tx * tx + ty * ty
        if square > 25.0 * sigma * sigma:
            sine: float = abs(dx * ty - dy * tx) / (length * math.sqrt(square))
            return sine
    return -1.0


@kernel
def trace_beams(
    starts: FloatArray,
    stops: FloatArray,
    ends: FloatArray,
    kinds: KindArray,
    origin: FloatArray,
    cell: float,
    hits: CountArray,
    passes: CountArray,
    nears: CountArray,
) -> None:
    """Count for each beam (B, 2) a pass in every cell from start to stop, a near pass in those from there to
    the end, and a hit in the end's cell. The last cell of a beam that met nothing is one more pass.

    Walks the grid cell by cell (Amanatides and Woo, A fast voxel traversal algorithm, 1987) in fixed point.
    Counts end at 65535. The grids (rows, cols) are contiguous and at least one cell wider than the beams all
    around.
    """
    cols = hits.shape[1]
    hits_flat, passes_flat, nears_flat = hits.ravel(), passes.ravel(), nears.ravel()
    for b in range(starts.shape[0]):
        if kinds[b] == SILENT:
            continue
        x0, y0 = (starts[b, 0] - origin[0]) / cell, (starts[b, 1] - origin[1]) / cell
        x1, y1 = (ends[b, 0] - origin[0]) / cell, (ends[b, 1] - origin[1]) / cell
        ix, iy, end_x, end_y = int(x0), int(y0), int(x1), int(y1)
        stop_x, stop_y = int((stops[b, 0] - origin[0]) / cell), int((stops[b, 1] - origin[1]) / cell)
        across, along = abs(x1 - x0), abs(y1 - y0)
        step_x, step_y = (1 if x1 > x0 else -1), (cols if y1 > y0 else -cols)
        # how much later, times both speeds, the beam enters the next row than the next column
        to_col = (ix + 1 - x0 if x1 > x0 else x0 - ix if x1 < x0 else 1.0) * along
        to_row = (iy + 1 - y0 if y1 > y0 else y0 - iy if y1 < y0 else 1.0) * across
        scale = 2.0**40 / max(across + along, 1e-9)
        later = int((to_row - to_col) * scale)
        per_col, per_row = int(along * scale), int(across * scale)
        steps = abs(end_x - ix) + abs(end_y - iy)
        sure = min(steps, abs(stop_x - ix) + abs(stop_y - iy) + 1)
        at = iy * cols + ix
        for step in range(steps):
            _count(passes_flat if step < sure else nears_flat, at)
            # which way a beam goes next cannot be predicted: masks, not branches (-1: into the next row)
            in_row = later >> 63
            at += step_x + (in_row & (step_y - step_x))
            later += (in_row & (per_col + per_row)) - per_col
        _count(hits_flat if kinds[b] == HIT else passes_flat, end_y * cols + end_x)


@helper
def _count(counts: CountArray, at: int) -> None:
    k = np.uintp(at)  # unsigned: no check for negative indices
    known = counts[k]
    counts[k] = known + (known != FULL)


@kernel
def bridge_hits(
    ends: FloatArray,
    kinds: KindArray,
    facings: Int8Array,
    sectors: int,
    origin: FloatArray,
    cell: float,
    limit: float,
    hits: CountArray,
) -> None:
    """Count a hit in every cell between neighbouring hits of one surface, not farther than ``limit`` m apart: beams that
    fan out leave a wall dotted where cells are small.

    ``facings`` (C, N): the sector, of so many, that a hit's surface faces; -1 for none.
    """
    for k in range(ends.shape[0]):
        for j in range(ends.shape[1] - 1):
            if kinds[k, j] != HIT or kinds[k, j + 1] != HIT or facings[k, j] < 0 or facings[k, j + 1] < 0:
                continue
            turn = (facings[k, j] - facings[k, j + 1]) % sectors
            if 1 < turn < sectors - 1:
                continue
            dx, dy = ends[k, j + 1, 0] - ends[k, j, 0], ends[k, j + 1, 1] - ends[k, j, 1]
            length = math.sqrt(dx * dx + dy * dy)
            x, y = (ends[k, j, 0] - origin[0]) / cell, (ends[k, j, 1] - origin[1]) / cell
            steps = max(abs(int(x + dx / cell) - int(x)), abs(int(y + dy / cell) - int(y)))
            if length > limit or steps < 2:
                continue
            angle = 2.0 * math.pi * facings[k, j] / sectors
            if abs(math.cos(angle) * dx + math.sin(angle) * dy) > 0.6 * length:
                continue
            for step in range(1, steps):
                share = step / steps
                row, col = int(y + share * dy / cell), int(x + share * dx / cell)
                if hits[row, col] < FULL:
                    hits[row, col] += 1
