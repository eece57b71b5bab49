"""How uncertain every keyframe is, seen from one of them, without a factorisation of the graph."""

from __future__ import annotations

import math
from array import array

import numpy as np

from mfslam.kernels import reach
from mfslam.types import Edge, FloatArray

# what an edge that leaves a direction open says of it at least: 1 m, 1 m, 0.3 rad
LEAST_KNOWN = np.diag([1.0, 1.0, 10.0])


class RelativeUncertainty:
    """Grows with the graph; bounds the joint marginals from above by covariances along shortest paths."""

    def __init__(self) -> None:
        self._ends = array("q")  # i, j of each edge
        self._variances = array("d")  # of position, of heading of each edge

    def add(self, edge: Edge, torn: bool = False) -> None:
        """Take note of an edge between two keyframes; ``torn``: nobody watched the robot between them, and
        what the edge leaves open is open."""
        covariance = np.linalg.inv(edge.information + (0.0 if torn else LEAST_KNOWN))
        self._ends.extend((edge.i, edge.j))
        self._variances.extend((covariance[0, 0] + covariance[1, 1], covariance[2, 2]))

    def remove(self, edge: Edge) -> None:
        """Forget a loop: no path leads over it any more. What ties a keyframe to the next stays."""
        if edge.j == edge.i + 1:
            return
        for n in range(len(self._ends) // 2):
            if self._ends[2 * n] == edge.i and self._ends[2 * n + 1] == edge.j:
                self._variances[2 * n] = self._variances[2 * n + 1] = math.inf

    def seen_from(self, keyframe: int, world_T_body: FloatArray) -> tuple[FloatArray, FloatArray]:
        """One-sigma position (m) and heading (rad), (K,) each, of every keyframe seen from one of them."""
        count = len(world_T_body)
        pairs = np.array(self._ends).reshape(-1, 2)
        variances = np.array(self._variances).reshape(-1, 2)
        ends, others = pairs.T.ravel(), pairs[:, ::-1].T.ravel()
        order = np.argsort(ends, kind="stable")
        first = np.searchsorted(ends[order], np.arange(count + 1)).astype(np.int64)
        out = reach.relative_sigmas(
            keyframe, world_T_body, first, others[order], np.concatenate([variances, variances])[order]
        )
        return np.sqrt(out[:, 0]), np.sqrt(out[:, 1])
