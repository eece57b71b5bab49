"""Correlative search: which pose of a point set best covers a likelihood grid, over a whole window."""

import math

import numpy as np
import numpy.typing as npt
from numba import njit

from mfslam.types import FloatArray, IntArray

ByteArray = npt.NDArray[np.uint8]


@njit(cache=True, nogil=True)
def likelihood_grid(
    points: FloatArray, origin: FloatArray, rows: int, cols: int, cell: float, sigma: float
) -> ByteArray:
    """Grid (rows, cols) of exp(-d^2 / 2 sigma^2) * 255 to the nearest of ``points`` (M, 2), near them."""
    grid = np.zeros((rows, cols), np.uint8)
    reach = math.ceil(2.5 * sigma / cell)
    for k in range(points.shape[0]):
        fx, fy = (points[k, 0] - origin[0]) / cell, (points[k, 1] - origin[1]) / cell
        cx, cy = math.floor(fx), math.floor(fy)
        for iy in range(max(0, cy - reach), min(rows, cy + reach + 1)):
            for ix in range(max(0, cx - reach), min(cols, cx + reach + 1)):
                dx, dy = (ix + 0.5 - fx) * cell, (iy + 0.5 - fy) * cell
                v = int(255.0 * math.exp(-(dx * dx + dy * dy) / (2.0 * sigma * sigma)))
                if v > grid[iy, ix]:
                    grid[iy, ix] = v
    return grid


@njit(cache=True, nogil=True)
def pyramid(grid: ByteArray, levels: int) -> ByteArray:
    """(levels, rows, cols): level h holds the maximum over the 2^h x 2^h block that starts at each cell,
    an upper bound of the score for every shift inside the block."""
    rows, cols = grid.shape
    out = np.zeros((levels, rows, cols), np.uint8)
    for i in range(rows):  # a whole level at once would take seconds to compile
        for j in range(cols):
            out[0, i, j] = grid[i, j]
    for h in range(1, levels):
        step = 1 << (h - 1)
        for i in range(rows):
            i2 = min(i + step, rows - 1)
            for j in range(cols):
                j2 = min(j + step, cols - 1)
                best = max(out[h - 1, i, j], out[h - 1, i, j2])
                out[h, i, j] = max(best, max(out[h - 1, i2, j], out[h - 1, i2, j2]))
    return out


@njit(cache=True, nogil=True, inline="always")
def _score(grid: ByteArray, cx: IntArray, cy: IntArray, ox: int, oy: int, pad: int) -> int:
    """Sum over the points shifted by (ox, oy) cells; ``pad`` cells below 0 still count as their block."""
    rows, cols = grid.shape
    total = 0
    for k in range(cx.shape[0]):
        x, y = cx[k] + ox, cy[k] + oy
        if x < 0:
            if x <= -pad:
                continue
            x = 0
        if y < 0:
            if y <= -pad:
                continue
            y = 0
        if x < cols and y < rows:
            total += grid[y, x]
    return total


@njit(cache=True, nogil=True)
def branch_and_bound(
    levels: ByteArray,
    origin: FloatArray,
    cell: float,
    points: FloatArray,
    center: FloatArray,
    angles: FloatArray,
    half_window: float,
    min_score: float,
    avoid: FloatArray,
) -> tuple[FloatArray, float]:
    """Best pose of ``points`` (M, 2) within the window about ``center``, exactly as on the finest grid.

    ``angles``: headings added to the centre's. ``min_score`` and the returned score are shares of the
    perfect one, 0 to 1; a score of 0 says that nothing reached ``min_score``. ``avoid`` (x, y, radius):
    no answer from inside that circle (radius 0: none is avoided).
    """
    top = levels.shape[0] - 1
    m = points.shape[0]
    perfect = 255.0 * max(m, 1)
    best = min_score * perfect
    pose = center.copy()
    found = 0.0
    half = math.ceil(half_window / cell)
    block = 1 << top
    per_side = (2 * half) // block + 1
    n_angles = angles.shape[0]
    cx = np.empty((n_angles, m), np.int64)
    cy = np.empty((n_angles, m), np.int64)
    for a in range(n_angles):
        c, s = math.cos(center[2] + angles[a]), math.sin(center[2] + angles[a])
        for k in range(m):
            x = center[0] + c * points[k, 0] - s * points[k, 1]
            y = center[1] + s * points[k, 0] + c * points[k, 1]
            cx[a, k] = math.floor((x - origin[0]) / cell)
            cy[a, k] = math.floor((y - origin[1]) / cell)
    n_top = n_angles * per_side * per_side
    scores = np.empty(n_top)
    for a in range(n_angles):
        for u in range(per_side):
            for v in range(per_side):
                at = (a * per_side + u) * per_side + v
                scores[at] = _score(levels[top], cx[a], cy[a], u * block - half, v * block - half, block)
    order = np.argsort(-scores)
    # depth first: (level, angle, ox, oy) with the bound that put it on the stack
    stack = np.empty((4 * (top + 1) + 4, 4), np.int64)
    bounds = np.empty(4 * (top + 1) + 4)
    for o in order:
        if scores[o] <= best:
            break
        stack[0, 0], stack[0, 1] = top, o // (per_side * per_side)
        stack[0, 2] = ((o // per_side) % per_side) * block - half
        stack[0, 3] = (o % per_side) * block - half
        bounds[0] = scores[o]
        depth = 1
        while depth > 0:
            depth -= 1
            if bounds[depth] <= best:
                continue
            h, a, ox, oy = stack[depth, 0], stack[depth, 1], stack[depth, 2], stack[depth, 3]
            if h == 0:
                px, py = center[0] + ox * cell, center[1] + oy * cell
                if avoid[2] > 0.0:
                    ax, ay = px - avoid[0], py - avoid[1]
                    if ax * ax + ay * ay < avoid[2] * avoid[2]:
                        continue
                best = bounds[depth]
                found = best / perfect
                pose[0], pose[1], pose[2] = px, py, center[2] + angles[a]
                continue
            step = 1 << (h - 1)
            base = depth
            for du in (0, step):
                for dv in (0, step):
                    bound = _score(levels[h - 1], cx[a], cy[a], ox + du, oy + dv, step)
                    if bound <= best:
                        continue
                    # insertion keeps the most promising child on top of the stack
                    at = depth
                    while at > base and bounds[at - 1] > bound:
                        bounds[at] = bounds[at - 1]
                        for u in range(4):
                            stack[at, u] = stack[at - 1, u]
                        at -= 1
                    bounds[at] = bound
                    stack[at, 0], stack[at, 1], stack[at, 2], stack[at, 3] = h - 1, a, ox + du, oy + dv
                    depth += 1
    return pose, found
