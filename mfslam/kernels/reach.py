"""How uncertain every keyframe is, seen from one of them: covariances along shortest paths."""

import heapq

import numpy as np

from mfslam.kernels.compiling import kernel
from mfslam.types import FloatArray, IntArray

LEVER_M = 10.0  # weighs heading against position when paths are compared


@kernel
def relative_sigmas(
    start: int,
    poses: FloatArray,
    newest: IntArray,
    older: IntArray,
    ends: IntArray,
    variances: FloatArray,
) -> FloatArray:
    """(K, 3) variances (x + y in m^2, heading in rad^2, path cost) of every keyframe seen from ``start``.

    Edge e has the ends 2 e and 2 e + 1, at the keyframes ``ends`` (2 E,), and (position, heading)
    ``variances`` (E, 2). The ends at a keyframe are linked: ``newest`` (K,) is the last of them, ``older``
    (2 E,) the one before each, -1 where there is none. So the graph grows at no cost. One path bounds the joint marginal from above, at the price of a
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
        end = newest[k]
        while end >= 0:
            m, vp, vh = ends[end ^ 1], variances[end >> 1, 0], variances[end >> 1, 1]
            end = older[end]
            if done[m]:
                continue
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
