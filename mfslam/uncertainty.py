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
SINGLY = 2000  # keyframes, up to which each is a knot of the paths; beyond, so many in a row are one knot
ROW = 8


class RelativeUncertainty:
    """Grows with the graph; bounds the joint marginals from above by covariances along shortest paths.

    Exact as far as `SINGLY` keyframes go. On longer logs paths lead from row to row of keyframes, what is driven within a
    row being left out: a tenth of the price, and nothing that a search for loops would notice.
    """

    def __init__(self) -> None:
        self._singly, self._rows = _Ties(), _Ties()
        self._row_tie = array("q")  # of each tie that of its rows, -1: none
        self._driven = (0.0, 0.0)  # variances of position and heading since the latest row began
        self._row_driven = (0.0, 0.0)  # of the latest whole row
        self._newest = 0  # keyframe that a step led to
        self._latest: tuple[int, int, FloatArray] | None = None  # row, number of ties, sigmas seen from there

    def add(self, edges: Sequence[Edge], torn: bool = False) -> None:
        """Take note of what ties two keyframes: a loop, or match and wheels of a step. ``torn``: nobody watched
        the robot between them, and what the edges leave open is open."""
        edge = edges[0]
        known = np.sum([e.information for e in edges if e.kind != "heading"], axis=0)
        covariance = np.linalg.inv(known + (0.0 if torn else LEAST_KNOWN)).tolist()
        variances = covariance[0][0] + covariance[1][1], covariance[2][2]
        self._singly.add(edge.i, edge.j, variances)
        self._row_tie.append(-1)
        i, j = edge.i // ROW, edge.j // ROW
        if edge.j == edge.i + 1 == self._newest + 1:
            self._newest = edge.j
            self._driven = _sum(self._driven, variances)
            if i != j:
                self._row_driven, self._driven = self._driven, (0.0, 0.0)
                self._rows.add(i, j, self._row_driven)
        elif i != j:
            self._row_tie[-1] = len(self._rows)
            self._rows.add(i, j, _sum(variances, self._row_driven))  # half a row at either end

    def remove(self, edge: Edge) -> None:
        """Forget a loop: no path leads over it any more. What ties a keyframe to the next stays."""
        if edge.j == edge.i + 1:
            return
        self._latest = None
        for n in self._singly.between(edge.i, edge.j):
            self._singly.cut(n)
            if self._row_tie[n] >= 0:
                self._rows.cut(self._row_tie[n])

    def seen_from(self, keyframe: int, world_T_body: FloatArray) -> tuple[FloatArray, FloatArray]:
        """One-sigma position (m) and heading (rad), (K,) each, of every keyframe seen from one of them."""
        count, row = len(world_T_body), keyframe // ROW
        if count <= SINGLY:
            sigmas = self._singly.sigmas(keyframe, world_T_body)
            return sigmas[0], sigmas[1]
        if self._latest is None or self._latest[:2] != (row, len(self._rows)):
            middles = np.minimum(np.arange(-(-count // ROW)) * ROW + ROW // 2, count - 1)
            self._latest = row, len(self._rows), self._rows.sigmas(row, world_T_body[middles])
        sigmas = np.repeat(self._latest[2], ROW, axis=1)[:, :count]
        return sigmas[0], sigmas[1]


class _Ties:
    """What ties knots of paths: keyframes, or rows of them."""

    def __init__(self) -> None:
        self._ends = array("q")  # i, j of each tie
        self._variances = array("d")  # of position, of heading of each tie
        # the ties of a knot as a list that is linked through their ends (place h of _ends is end h)
        self._newest = array("q")  # end of each knot, -1: none
        self._older = array("q")  # for each end the one before it at the same knot

    def __len__(self) -> int:
        return len(self._ends) // 2

    def add(self, i: int, j: int, variances: tuple[float, float]) -> None:
        self._newest.extend([-1] * (max(i, j) + 1 - len(self._newest)))
        for knot in (i, j):
            self._older.append(self._newest[knot])
            self._newest[knot] = len(self._ends)
            self._ends.append(knot)
        self._variances.extend(variances)

    def between(self, i: int, j: int) -> list[int]:
        """Numbers of the ties from i to j."""
        return [n for n in range(len(self)) if self._ends[2 * n] == i and self._ends[2 * n + 1] == j]

    def cut(self, number: int) -> None:
        self._variances[2 * number] = self._variances[2 * number + 1] = math.inf

    def sigmas(self, start: int, poses: FloatArray) -> FloatArray:
        """(2, N) one-sigma position (m) and heading (rad) of knots at ``poses`` (N, 3), seen from knot ``start``."""
        newest = np.full(len(poses), -1, np.int64)
        newest[: len(self._newest)] = np.frombuffer(self._newest, np.int64)[: len(newest)]
        out = reach.relative_sigmas(
            start,
            poses,
            newest,
            np.frombuffer(self._older, np.int64) if self._older else newest,
            np.frombuffer(self._ends, np.int64) if self._ends else newest,
            np.frombuffer(self._variances).reshape(-1, 2) if self._variances else np.empty((0, 2)),
        )
        sigmas: FloatArray = np.sqrt(out[:, :2].T)
        return sigmas


def _sum(a: tuple[float, float], b: tuple[float, float]) -> tuple[float, float]:
    return a[0] + b[0], a[1] + b[1]


def chi2_quantile(probability: float) -> float:
    """Quantile of chi2 with three degrees of freedom."""
    from scipy.special import chdtri

    return float(chdtri(3, 1.0 - probability))
