"""How uncertain every keyframe is, seen from one of them, without a factorisation of the graph."""

from __future__ import annotations

import numpy as np

from mfslam.kernels import reach
from mfslam.types import Edge, FloatArray

# what an edge that leaves a direction open says of it at least: 1 m, 1 m, 0.3 rad
LEAST_KNOWN = np.diag([1.0, 1.0, 10.0])


class RelativeUncertainty:
    """Grows with the graph; bounds the joint marginals from above by covariances along shortest paths."""

    def __init__(self) -> None:
        self._i: list[int] = []
        self._j: list[int] = []
        self._variances: list[tuple[float, float]] = []

    def add(self, edge: Edge) -> None:
        """Take note of an edge between two keyframes."""
        covariance = np.linalg.inv(edge.information + LEAST_KNOWN)
        self._i.append(edge.i)
        self._j.append(edge.j)
        self._variances.append((covariance[0, 0] + covariance[1, 1], covariance[2, 2]))

    def seen_from(self, keyframe: int, world_T_body: FloatArray) -> tuple[FloatArray, FloatArray]:
        """One-sigma position (m) and heading (rad), (K,) each, of every keyframe seen from one of them."""
        count = len(world_T_body)
        i, j = np.array(self._i, dtype=np.int64), np.array(self._j, dtype=np.int64)
        variances = np.array(self._variances).reshape(-1, 2)
        ends, others = np.concatenate([i, j]), np.concatenate([j, i])
        order = np.argsort(ends, kind="stable")
        first = np.searchsorted(ends[order], np.arange(count + 1)).astype(np.int64)
        out = reach.relative_sigmas(
            keyframe, world_T_body, first, others[order], np.concatenate([variances, variances])[order]
        )
        return np.sqrt(out[:, 0]), np.sqrt(out[:, 1])
