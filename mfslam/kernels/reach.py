"""How surely one pose of a graph knows of the others: covariances along surest paths."""

import heapq
import math

import numpy as np

from mfslam.kernels.compiling import helper, kernel
from mfslam.types import FloatArray, IntArray

LEVER_M = 10.0  # weighs heading against position when paths are compared


@helper
def _carry(
    out: FloatArray, m: int, covariance: FloatArray, poses: FloatArray, k: int, room: FloatArray
) -> None:
    """out[m] = A C A^T, A the adjoint that carries the errors of pose k, ``covariance`` C (3, 3), into the frame of pose m."""
    c, s = math.cos(poses[m, 2]), math.sin(poses[m, 2])
    dx, dy = poses[k, 0] - poses[m, 0], poses[k, 1] - poses[m, 1]
    x, y, turn = c * dx + s * dy, -s * dx + c * dy, poses[k, 2] - poses[m, 2]
    c, s = math.cos(turn), math.sin(turn)
    for v in range(3):
        a, b, w = covariance[0, v], covariance[1, v], covariance[2, v]
        room[0, v], room[1, v], room[2, v] = c * a - s * b + y * w, s * a + c * b - x * w, w
    for u in range(3):
        a, b, w = room[u, 0], room[u, 1], room[u, 2]
        out[m, u, 0], out[m, u, 1], out[m, u, 2] = c * a - s * b + y * w, s * a + c * b - x * w, w


@kernel
def carried(a_T_b: FloatArray, covariance: FloatArray) -> FloatArray:
    """A covariance (3, 3) in the tangent of pose a, in that of pose b."""
    poses, out = np.zeros((2, 3)), np.empty((2, 3, 3))
    for d in range(3):
        poses[1, d] = a_T_b[d]
    _carry(out, 1, covariance, poses, 0, np.empty((3, 3)))
    at_b: FloatArray = out[1].copy()
    return at_b


@kernel
def path_covariances(
    start: int,
    covariance: FloatArray,
    poses: FloatArray,
    newest: IntArray,
    older: IntArray,
    ends: IntArray,
    covariances: FloatArray,
    most: float,
) -> tuple[FloatArray, FloatArray]:
    """(K, 3, 3) covariance in the tangent of every pose of ``poses`` (K, 3), that of ``start`` being ``covariance`` (3, 3), and what
    its surest path from there costs (K,), in m^2; infinite where there is none that costs at most ``most``.

    Tie e has the ends 2 e and 2 e + 1, at the poses ``ends`` (2 E,): the first sees the second with ``covariances`` (E, 3, 3)
    in the tangent of the second. The ends at a pose are linked: ``newest`` (K,) is the last of them, ``older`` (2 E,) the one
    before each, -1 where there is none. So the graph grows at no cost. One path bounds the joint marginal from above, at the
    price of a search instead of a factorisation.
    """
    n = poses.shape[0]
    cost = np.full(n, np.inf)
    via = np.full(n, -1, np.int64)  # the end by which each pose was reached
    done = np.zeros(n, np.bool_)
    out = np.full((n, 3, 3), np.inf)
    before, room = np.empty((3, 3)), np.empty((3, 3))
    cost[start] = 0.0
    heap = [(0.0, start)]
    while len(heap) > 0:
        at, k = heapq.heappop(heap)
        if done[k]:
            continue
        done[k] = True
        if via[k] < 0:
            for u in range(3):
                for v in range(3):
                    out[k, u, v] = covariance[u, v]
        else:
            tie, origin = via[k] >> 1, ends[via[k] ^ 1]
            forth = via[k] & 1  # along the tie: its own error lies at the far end, else at the near one
            for u in range(3):
                for v in range(3):
                    before[u, v] = out[origin, u, v] + (0.0 if forth else covariances[tie, u, v])
            _carry(out, k, before, poses, origin, room)
            if forth:
                for u in range(3):
                    for v in range(3):
                        out[k, u, v] += covariances[tie, u, v]
        end = newest[k]
        while end >= 0:
            m, e = ends[end ^ 1], end >> 1
            if not done[m]:
                own = covariances[e, 0, 0] + covariances[e, 1, 1] + LEVER_M * LEVER_M * covariances[e, 2, 2]
                if at + own < cost[m] and at + own <= most:
                    cost[m] = at + own
                    via[m] = end ^ 1
                    heapq.heappush(heap, (cost[m], m))
            end = older[end]
    return out, cost
