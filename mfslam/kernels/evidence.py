"""What a place says of every cell: seen occupied, seen free, or unknown; and how two places agree."""

import math

import numpy as np
import numpy.typing as npt

from mfslam.kernels.compiling import kernel
from mfslam.types import FloatArray, IntArray

UNKNOWN, FREE, OCCUPIED = 0, 1, 2
ByteArray = npt.NDArray[np.uint8]


@kernel
def evidence_grid(
    origins: FloatArray,
    first: IntArray,
    points: FloatArray,
    corner: FloatArray,
    rows: int,
    cols: int,
    cell: float,
) -> ByteArray:
    """States (rows, cols) from rays origins[s] -> points[first[s]:first[s + 1]].

    A cell that any ray ends in is occupied; one that two or more pass is free. The last two cells of a
    ray are left alone: grazing rays run along walls.
    """
    passes = np.zeros((rows, cols), np.uint8)
    grid = np.zeros((rows, cols), np.uint8)
    for s in range(origins.shape[0]):
        ox, oy = (origins[s, 0] - corner[0]) / cell, (origins[s, 1] - corner[1]) / cell
        for k in range(first[s], first[s + 1]):
            dx, dy = (points[k, 0] - corner[0]) / cell - ox, (points[k, 1] - corner[1]) / cell - oy
            length = math.sqrt(dx * dx + dy * dy)
            steps = int(length - 2.0)
            if length > 0.0:
                ux, uy = dx / length, dy / length
                last_x, last_y = -1, -1
                for t in range(steps):
                    fx, fy = ox + ux * t, oy + uy * t
                    if fx < 0.0 or fy < 0.0:
                        continue
                    ix, iy = int(fx), int(fy)
                    if ix == last_x and iy == last_y:
                        continue  # a step may stay within its cell: one ray is one witness
                    last_x, last_y = ix, iy
                    if ix < cols and iy < rows and passes[iy, ix] < 2:
                        passes[iy, ix] += 1
    for iy in range(rows):
        for ix in range(cols):
            if passes[iy, ix] >= 2:
                grid[iy, ix] = FREE
    for k in range(points.shape[0]):
        ix = math.floor((points[k, 0] - corner[0]) / cell)
        iy = math.floor((points[k, 1] - corner[1]) / cell)
        if 0 <= ix < cols and 0 <= iy < rows:
            grid[iy, ix] = OCCUPIED
    return grid


@kernel
def agreement(
    grid: ByteArray, corner: FloatArray, cell: float, grid_T_points: FloatArray, points: FloatArray
) -> tuple[int, int, int]:
    """How many points fall on (or beside) occupied cells, how many in the open, and how many there are.

    Points in unknown cells count only in the last.
    """
    rows, cols = grid.shape
    c, s = math.cos(grid_T_points[2]), math.sin(grid_T_points[2])
    agree = contradict = 0
    for k in range(points.shape[0]):
        x = grid_T_points[0] + c * points[k, 0] - s * points[k, 1]
        y = grid_T_points[1] + s * points[k, 0] + c * points[k, 1]
        ix, iy = math.floor((x - corner[0]) / cell), math.floor((y - corner[1]) / cell)
        if ix < 0 or iy < 0 or ix >= cols or iy >= rows:
            continue
        near_wall = False
        for v in range(max(0, iy - 1), min(rows, iy + 2)):
            for u in range(max(0, ix - 1), min(cols, ix + 2)):
                if grid[v, u] == OCCUPIED:
                    near_wall = True
        if near_wall:
            agree += 1
        elif grid[iy, ix] == FREE:
            contradict += 1
    return agree, contradict, points.shape[0]
