"""The partner of every point: the nearest one in a hash grid, sought again only where it may have changed."""

import math

import numpy as np

from mfslam.kernels.cells import cell_key, find_slot
from mfslam.kernels.compiling import kernel
from mfslam.types import FloatArray, IntArray

FIRST_LOOK = 0.4  # of a cell: most points have a partner that near


@kernel
def nothing_known(count: int) -> tuple[IntArray, FloatArray]:
    """What `find_partners` knows of ``count`` points before it has sought any."""
    return np.full(count, -1, np.int64), np.full((count, 3), -1.0)


@kernel
def find_partners(
    index: IntArray,
    rows: FloatArray,
    cell: float,
    placed: FloatArray,
    radius: float,
    min_cos: float,
    partner: IntArray,
    seen: FloatArray,
) -> None:
    """Row of the nearest point for every one of ``placed`` (M, 4): x, y, nx, ny, among those within ``radius``
    whose normal agrees (where both have one); -1 without any.

    ``index``, ``rows``: the parts of a CellTable. ``partner`` (M,) and ``seen`` (M, 3) are those of
    `nothing_known` at first, and keep what was found: from where it was sought, and how far the point may
    move from there before another one could be nearer, or, where there was none, how far was looked. In an
    iteration that moves a scan by a millimetre nearly all keep theirs. A partner that was kept may by now lie
    beyond ``radius``: whoever needs to know looks at the distance.
    """
    for i in range(placed.shape[0]):
        x, y, nx, ny = placed[i, 0], placed[i, 1], placed[i, 2], placed[i, 3]
        dx, dy = x - seen[i, 0], y - seen[i, 1]
        free = seen[i, 2] - (radius if partner[i] < 0 else 0.0)
        if free > 0.0 and dx * dx + dy * dy < free * free:
            continue
        oriented = nx != 0.0 or ny != 0.0
        reach = min(radius, FIRST_LOOK * cell)
        while True:
            best, best_d2, next_d2 = -1, reach * reach, reach * reach
            y0, y1 = math.floor((y - reach) / cell), math.floor((y + reach) / cell)
            for ix in range(math.floor((x - reach) / cell), math.floor((x + reach) / cell) + 1):
                for iy in range(y0, y1 + 1):
                    slot = find_slot(index, cell_key(ix, iy))
                    for q in range(index[slot, 1], index[slot, 2]):  # of a free slot: none
                        dx, dy = rows[q, 0] - x, rows[q, 1] - y
                        d2 = dx * dx + dy * dy
                        if d2 >= next_d2:
                            continue
                        both_oriented = oriented and (rows[q, 2] != 0.0 or rows[q, 3] != 0.0)
                        if both_oriented and nx * rows[q, 2] + ny * rows[q, 3] < min_cos:
                            continue
                        if d2 < best_d2:
                            best, best_d2, next_d2 = q, d2, best_d2
                        else:
                            next_d2 = d2
            if best >= 0 or reach >= radius:
                break
            reach = min(radius, 2.5 * reach)
        partner[i] = best
        seen[i, 0], seen[i, 1] = x, y
        seen[i, 2] = 0.5 * (math.sqrt(next_d2) - math.sqrt(best_d2)) if best >= 0 else radius
