"""Every beam of every scan into a grid of hits and passes."""

import math

import numpy as np
import numpy.typing as npt
from numba import njit

from mfslam.types import FloatArray


CountArray = npt.NDArray[np.int32]


@njit(cache=True, nogil=True)
def trace_beams(
    starts: FloatArray,
    ends: FloatArray,
    hit: npt.NDArray[np.bool_],
    origin: FloatArray,
    cell: float,
    hits: CountArray,
    passes: CountArray,
) -> None:
    """Count for each beam (B, 2) -> (B, 2) one pass in every cell before its end, one hit at the end.

    Walks the grid cell by cell (Amanatides and Woo). A beam without ``hit`` counts only passes. The
    grids must hold every beam.
    """
    for b in range(starts.shape[0]):
        x0, y0 = (starts[b, 0] - origin[0]) / cell, (starts[b, 1] - origin[1]) / cell
        x1, y1 = (ends[b, 0] - origin[0]) / cell, (ends[b, 1] - origin[1]) / cell
        ix, iy = int(x0), int(y0)
        ex, ey = int(x1), int(y1)
        dx, dy = x1 - x0, y1 - y0
        step_x, step_y = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
        tdx = abs(1.0 / dx) if dx != 0.0 else 1e30
        tdy = abs(1.0 / dy) if dy != 0.0 else 1e30
        tx = (ix + 1 - x0) * tdx if dx > 0 else (x0 - ix) * tdx
        ty = (iy + 1 - y0) * tdy if dy > 0 else (y0 - iy) * tdy
        remaining = abs(ex - ix) + abs(ey - iy)
        while remaining > 0:
            passes[iy, ix] += 1
            if tx < ty:
                tx += tdx
                ix += step_x
            else:
                ty += tdy
                iy += step_y
            remaining -= 1
        if hit[b]:
            hits[ey, ex] += 1
        else:
            passes[ey, ex] += 1
