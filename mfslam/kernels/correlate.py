"""Correlative search: which pose of a point set best covers a likelihood grid, over a whole window."""

import math

import numpy as np
import numpy.typing as npt

from mfslam.kernels.compiling import helper, kernel
from mfslam.types import FloatArray, IntArray

SAME_HEADING = math.cos(0.5)
ByteArray = npt.NDArray[np.uint8]


@kernel
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


@kernel
def pyramid(grid: ByteArray, levels: int) -> ByteArray:
    """(levels, B + rows + 1, B + cols + 1) with B = 2^(levels - 1): level h holds the maximum over the
    2^h x 2^h block that starts at each cell, an upper bound of the score for every shift inside the block.

    Cell (0, 0) of the grid lies at [h, B, B]: blocks that start before the grid may still reach into it. The
    first and the last row and column are all zeros: where whatever lies farther out looks.
    """
    pad = 1 << (levels - 1)
    rows, cols = grid.shape[0] + pad + 1, grid.shape[1] + pad + 1
    out = np.zeros((levels, rows, cols), np.uint8)
    for i in range(grid.shape[0]):  # a whole level at once would take seconds to compile
        for j in range(grid.shape[1]):
            out[0, i + pad, j + pad] = grid[i, j]
    for h in range(1, levels):
        step = 1 << (h - 1)
        for i in range(rows):
            i2 = min(i + step, rows - 1)
            for j in range(cols):
                j2 = min(j + step, cols - 1)
                best = max(out[h - 1, i, j], out[h - 1, i, j2])
                out[h, i, j] = max(best, max(out[h - 1, i2, j], out[h - 1, i2, j2]))
    return out


@helper
def _four_scores(
    levels: ByteArray, h: int, xs: IntArray, ys: IntArray, ox: int, oy: int, step: int, out: IntArray
) -> None:
    """Sums at level ``h`` over the points shifted by (ox, oy), (ox, oy + step), (ox + step, oy) and
    (ox + step, oy + step) cells. All four at once: their looks into memory do not wait for each other."""
    last_y, last_x = levels.shape[1] - 1, levels.shape[2] - 1
    grid = levels[h]
    s00 = s01 = s10 = s11 = 0
    for k in range(xs.shape[0]):
        x0, y0 = xs[k] + ox, ys[k] + oy
        x1, y1 = max(0, min(last_x, x0 + step)), max(0, min(last_y, y0 + step))
        x0, y0 = max(0, min(last_x, x0)), max(0, min(last_y, y0))
        s00 += grid[y0, x0]
        s01 += grid[y1, x0]
        s10 += grid[y0, x1]
        s11 += grid[y1, x1]
    out[0], out[1], out[2], out[3] = s00, s01, s10, s11


@helper
def _is_avoided(
    poses: FloatArray, count: int, radius: float, x: float, y: float, size: float, theta: float
) -> bool:
    """Whether one of the first ``count`` poses (3,) is nearer than ``radius`` to all of a block (x, y, size) and looks the same way."""
    for n in range(count):
        dx = max(abs(x - poses[n, 0]), abs(x + size - poses[n, 0]))
        dy = max(abs(y - poses[n, 1]), abs(y + size - poses[n, 1]))
        if dx * dx + dy * dy < radius * radius and math.cos(theta - poses[n, 2]) > SAME_HEADING:
            return True
    return False


@kernel
def branch_and_bound(
    levels: ByteArray,
    origin: FloatArray,
    cell: float,
    points: FloatArray,
    center: FloatArray,
    angles: FloatArray,
    half_window: float,
    min_score: float,
    most: int,
    rival_share: float,
    apart: float,
) -> tuple[FloatArray, FloatArray]:
    """The best poses (K, 3) of ``points`` (M, 2) within the window about ``center``, exactly as on the finest grid, and their scores
    (K,), the best first.

    ``levels``: of `pyramid`, ``origin`` (2,) the corner of its grid. ``angles``: headings added to the
    centre's. ``min_score`` and the scores returned are shares of the perfect one, 0 to 1. At most ``most`` poses, those after the first
    with ``rival_share`` of its score at least, and not nearer than ``apart`` to one before that looks the same way.
    """
    top = levels.shape[0] - 1
    m = points.shape[0]
    perfect = 255 * max(m, 1)
    half = math.ceil(half_window / cell)
    block = 1 << top
    per_side = (2 * half) // block + 1
    n_angles = angles.shape[0]
    xs = np.empty((n_angles, m), np.int64)
    ys = np.empty((n_angles, m), np.int64)
    for a in range(n_angles):
        c, s = math.cos(center[2] + angles[a]), math.sin(center[2] + angles[a])
        for k in range(m):
            x = center[0] + c * points[k, 0] - s * points[k, 1]
            y = center[1] + s * points[k, 0] + c * points[k, 1]
            xs[a, k] = block + math.floor((x - origin[0]) / cell)
            ys[a, k] = block + math.floor((y - origin[1]) / cell)
    four = np.zeros(4, np.int64)
    side = per_side + 1
    scores = np.zeros(n_angles * side * side, np.int64)
    for a in range(n_angles):
        for u in range(0, per_side, 2):
            for v in range(0, per_side, 2):
                _four_scores(levels, top, xs[a], ys[a], u * block - half, v * block - half, block, four)
                at = (a * side + u) * side + v
                scores[at], scores[at + 1] = four[0], four[1]
                scores[at + side], scores[at + side + 1] = four[2], four[3]
    order = _best_first(scores, perfect, min_score * perfect)
    poses, found = np.zeros((most, 3)), np.zeros(most)
    # depth first: (level, angle, ox, oy, bound that put it on the stack)
    stack = np.empty((4 * (top + 1) + 4, 5), np.int64)
    count = 0
    while count < most:
        best = (rival_share * found[0] if count else min_score) * perfect
        for n in range(order.shape[0]):
            a, u, v = order[n] // (side * side), (order[n] // side) % side, order[n] % side
            if u == per_side or v == per_side:
                continue
            stack[0, 0], stack[0, 1], stack[0, 2], stack[0, 3] = top, a, u * block - half, v * block - half
            stack[0, 4] = scores[order[n]]
            depth = 1
            while depth > 0:
                depth -= 1
                if stack[depth, 4] <= best:
                    continue
                h, a, ox, oy = stack[depth, 0], stack[depth, 1], stack[depth, 2], stack[depth, 3]
                px, py, theta = center[0] + ox * cell, center[1] + oy * cell, center[2] + angles[a]
                if _is_avoided(poses, count, apart, px, py, ((1 << h) - 1) * cell, theta):
                    continue
                if h == 0:
                    best = float(stack[depth, 4])
                    found[count] = best / perfect
                    poses[count, 0], poses[count, 1], poses[count, 2] = px, py, theta
                    continue
                step = 1 << (h - 1)
                _four_scores(levels, h - 1, xs[a], ys[a], ox, oy, step, four)
                base = depth
                for child in range(4):
                    bound = four[child]
                    if bound <= best:
                        continue
                    # insertion keeps the most promising child on top of the stack
                    at = depth
                    while at > base and stack[at - 1, 4] > bound:
                        for u in range(5):
                            stack[at, u] = stack[at - 1, u]
                        at -= 1
                    stack[at, 0], stack[at, 1], stack[at, 4] = h - 1, a, bound
                    stack[at, 2], stack[at, 3] = ox + step * (child // 2), oy + step * (child % 2)
                    depth += 1
        if found[count] == 0.0:
            break
        count += 1
    return poses[:count], found[:count]


@helper
def _best_first(scores: IntArray, perfect: int, least: float) -> IntArray:
    """Indices of the scores (N,) above ``least``, the best first: sorted into 256 bins, which is near enough
    for an order to search in."""
    first = np.zeros(258, np.int64)
    for k in range(scores.shape[0]):
        if scores[k] > least:
            first[257 - (256 * scores[k]) // (perfect + 1)] += 1
    for b in range(1, 258):
        first[b] += first[b - 1]
    order = np.empty(first[257], np.int64)
    for k in range(scores.shape[0]):
        if scores[k] > least:
            b = 256 - (256 * scores[k]) // (perfect + 1)
            order[first[b]] = k
            first[b] += 1
    return order
