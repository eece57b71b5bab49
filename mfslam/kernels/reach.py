"""How uncertain every keyframe is, seen from one of them: covariances along shortest paths."""

import heapq

import numpy as np
from numba import njit

from mfslam.types import FloatArray, IntArray

LEVER_M = 10.0  # weighs heading against position when paths are compared


@njit(cache=True, nogil=True)
def relative_sigmas(
    start: int, poses: FloatArray, first: IntArray, other: IntArray, covariances: FloatArray
) -> FloatArray:
    """(K, 3) variances (x + y in m^2, heading in rad^2, path cost) of every keyframe seen from ``start``.

    The graph is given by rows: edges first[k]:first[k + 1] of keyframe k lead to ``other`` and carry
    (position, heading) variances. One path bounds the joint marginal from above, at the price of a
    search instead of a factorisation: heading errors act on position with the distance still to go.
    """
    n = poses.shape[0]
    out = np.full((n, 3), np.inf)
    done = np.zeros(n, np.bool_)
    out[start] = 0.0
    heap = [(0.0, start)]
    # second moments of the heading variance along the path: sum v, sum v x, sum v y, sum v (x^2 + y^2)
    moments = np.zeros((n, 4))
    position = np.zeros(n)
    while len(heap) > 0:
        cost, k = heapq.heappop(heap)
        if done[k]:
            continue
        done[k] = True
        for e in range(first[k], first[k + 1]):
            m = other[e]
            if done[m]:
                continue
            vp, vh = covariances[e, 0], covariances[e, 1]
            new_cost = cost + vp + LEVER_M * LEVER_M * vh
            if new_cost < out[m, 2]:
                out[m, 2] = new_cost
                x, y = poses[m, 0], poses[m, 1]
                moments[m, 0] = moments[k, 0] + vh
                moments[m, 1] = moments[k, 1] + vh * x
                moments[m, 2] = moments[k, 2] + vh * y
                moments[m, 3] = moments[k, 3] + vh * (x * x + y * y)
                position[m] = position[k] + vp
                # variance of the far end: each heading error turns all that follows
                swing = (
                    moments[m, 3]
                    - 2.0 * (x * moments[m, 1] + y * moments[m, 2])
                    + moments[m, 0] * (x * x + y * y)
                )
                out[m, 0] = position[m] + max(0.0, swing)
                out[m, 1] = moments[m, 0]
                heapq.heappush(heap, (new_cost, m))
    return out
