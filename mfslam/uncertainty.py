"""How uncertain every keyframe is, seen from one of them, without a factorisation of the graph."""

from __future__ import annotations

import math
from array import array
from collections.abc import Sequence

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
        # the edges of a keyframe as a list that is linked through their ends (place h of _ends is end h)
        self._newest = array("q")  # end of each keyframe, -1: none
        self._older = array("q")  # for each end the one before it at the same keyframe

    def add(self, edges: Sequence[Edge], torn: bool = False) -> None:
        """Take note of what ties two keyframes: a loop, or match and wheels of a step. ``torn``: nobody watched
        the robot between them, and what the edges leave open is open."""
        edge = edges[0]
        known = np.sum([e.information for e in edges if e.kind != "heading"], axis=0)
        covariance = np.linalg.inv(known + (0.0 if torn else LEAST_KNOWN)).tolist()
        self._newest.extend([-1] * (max(edge.i, edge.j) + 1 - len(self._newest)))
        for keyframe in (edge.i, edge.j):
            self._older.append(self._newest[keyframe])
            self._newest[keyframe] = len(self._ends)
            self._ends.append(keyframe)
        self._variances.extend((covariance[0][0] + covariance[1][1], covariance[2][2]))

    def remove(self, edge: Edge) -> None:
        """Forget a loop: no path leads over it any more. What ties a keyframe to the next stays."""
        if edge.j == edge.i + 1:
            return
        for n in range(len(self._ends) // 2):
            if self._ends[2 * n] == edge.i and self._ends[2 * n + 1] == edge.j:
                self._variances[2 * n] = self._variances[2 * n + 1] = math.inf

    def seen_from(self, keyframe: int, world_T_body: FloatArray) -> tuple[FloatArray, FloatArray]:
        """One-sigma position (m) and heading (rad), (K,) each, of every keyframe seen from one of them."""
        newest = np.full(len(world_T_body), -1, np.int64)
        newest[: len(self._newest)] = np.frombuffer(self._newest, np.int64)[: len(newest)]
        out = reach.relative_sigmas(
            keyframe,
            world_T_body,
            newest,
            np.frombuffer(self._older, np.int64) if self._older else newest,
            np.frombuffer(self._ends, np.int64) if self._ends else newest,
            np.frombuffer(self._variances).reshape(-1, 2) if self._variances else np.empty((0, 2)),
        )
        return np.sqrt(out[:, 0]), np.sqrt(out[:, 1])


def chi2_quantile(probability: float) -> float:
    """Quantile of chi2 with three degrees of freedom."""
    from scipy.special import chdtri

    return float(chdtri(3, 1.0 - probability))
