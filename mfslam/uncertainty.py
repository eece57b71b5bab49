"""How uncertain every keyframe is, seen from one of them, without a factorisation of the graph."""

from __future__ import annotations

import math
from array import array
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mfslam.kernels import reach
from mfslam.types import Edge, FloatArray

# what an edge that leaves a direction open says of it at least: 1 m, 1 m, 0.3 rad
LEAST_KNOWN = np.diag([1.0, 1.0, 10.0])
FRESH, REUSED = (
    8000,
    5,
)  # keyframes, up to which every look at them is a new one; beyond, one in so many for each FRESH


class RelativeUncertainty:
    """Grows with the graph; bounds the joint marginals from above by covariances along shortest paths."""

    def __init__(self) -> None:
        self._ends = array("q")  # i, j of each edge
        self._variances = array("d")  # of position, of heading of each edge
        # the edges of a keyframe as a list that is linked through their ends (place h of _ends is end h)
        self._newest = array("q")  # end of each keyframe, -1: none
        self._older = array("q")  # for each end the one before it at the same keyframe
        self._step_variances = array("d", (0.0, 0.0))  # position, heading: of the step to each keyframe
        self._latest: _Seen | None = None

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
        variances = covariance[0][0] + covariance[1][1], covariance[2][2]
        self._variances.extend(variances)
        if edge.j == edge.i + 1 and len(self._step_variances) == 2 * edge.j:
            self._step_variances.extend(variances)

    def remove(self, edge: Edge) -> None:
        """Forget a loop: no path leads over it any more. What ties a keyframe to the next stays."""
        if edge.j == edge.i + 1:
            return
        self._latest = None
        for n in range(len(self._ends) // 2):
            if self._ends[2 * n] == edge.i and self._ends[2 * n + 1] == edge.j:
                self._variances[2 * n] = self._variances[2 * n + 1] = math.inf

    def seen_from(self, keyframe: int, world_T_body: FloatArray) -> tuple[FloatArray, FloatArray]:
        """One-sigma position (m) and heading (rad), (K,) each, of every keyframe seen from one of them.

        Exact as far as `FRESH` keyframes go; on longer logs the paths are sought anew only every so many keyframes, and
        what the robot has driven since is added: still bounds, at a price that does not grow.
        """
        count, before = len(world_T_body), self._latest
        if before is None or not 0 <= keyframe - before.keyframe < REUSED * (count // FRESH):
            before = self._latest = _Seen(keyframe, *self._search(keyframe, world_T_body))
            return before.sigma_m, before.sigma_rad
        # of the steps since, and the swing of their headings; the keyframes since are near the newest one
        since = slice(before.keyframe + 1, keyframe + 1)
        step_m, step_rad = np.sqrt(np.sum(self._steps()[since], axis=0))
        away_m = np.hypot(*(world_T_body[:, :2] - world_T_body[keyframe, :2]).T)
        sigma_m, sigma_rad = np.full(count, step_m), np.full(count, step_rad)
        known = len(before.sigma_m)
        sigma_m[:known] += before.sigma_m
        sigma_rad[:known] += before.sigma_rad
        return sigma_m + step_rad * away_m, sigma_rad

    def _steps(self) -> FloatArray:
        """(K, 2) variances of position and heading of the step to each keyframe."""
        return np.frombuffer(self._step_variances).reshape(-1, 2)

    def _search(self, keyframe: int, world_T_body: FloatArray) -> tuple[FloatArray, FloatArray]:
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


@dataclass(frozen=True, eq=False)
class _Seen:
    """Sigmas of all keyframes as they were seen from one."""

    keyframe: int
    sigma_m: FloatArray
    sigma_rad: FloatArray


def chi2_quantile(probability: float) -> float:
    """Quantile of chi2 with three degrees of freedom."""
    from scipy.special import chdtri

    return float(chdtri(3, 1.0 - probability))
