"""Correlative branch-and-bound pose search: for recovery and for loop closure."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from mfslam.kernels import correlate
from mfslam.types import FloatArray

MAX_HYPOTHESES, ELSEWHERE_M = 3, 1.0
MAX_POINTS = 150  # more points sharpen a coarse search no further
FAR_SHARE = 0.8  # of the points are nearer than a typical far one


@dataclass(frozen=True, eq=False)
class SearchMap:
    """Likelihood grid of a place with its pyramid of upper bounds."""

    origin_m: FloatArray
    cell_m: float
    levels: npt.NDArray[np.uint8]

    @classmethod
    def of(cls, points_m: FloatArray, center_m: FloatArray, reach_m: float, cell_m: float) -> SearchMap:
        """Map of the points (M, 2) within a square of half side ``reach_m`` about ``center_m``."""
        if not len(points_m):
            return cls(center_m, cell_m, np.zeros((5, 1, 1), np.uint8))
        off_m = np.abs(points_m - center_m)
        # max(axis=1) of rows of two takes ten times as long
        near = (off_m[:, 0] < reach_m) & (off_m[:, 1] < reach_m)
        points = points_m[near] if near.any() else points_m[:1]
        margin = 3.0 * cell_m
        low, high = points.min(axis=0) - margin, points.max(axis=0) + margin
        cols, rows = (int(n) for n in np.ceil((high - low) / cell_m))
        grid = correlate.likelihood_grid(points, low, rows, cols, cell_m, cell_m)
        return cls(low, cell_m, correlate.pyramid(grid, 5))


def search(
    place: SearchMap,
    points_m: FloatArray,
    center: FloatArray,
    half_window_m: float,
    half_window_rad: float,
    min_score: float,
) -> tuple[FloatArray, float]:
    """Best pose (3,) of a point set within the window about ``center``, and its score, 0 to 1.

    The score is 0 where nothing reached ``min_score``.
    """
    found = hypotheses(place, points_m, center, half_window_m, half_window_rad, min_score, most=1)
    return found[0] if found else (center, 0.0)


def hypotheses(
    place: SearchMap,
    points_m: FloatArray,
    center: FloatArray,
    half_window_m: float,
    half_window_rad: float,
    min_score: float,
    rival_share: float = 0.9,
    most: int = MAX_HYPOTHESES + 1,
) -> list[tuple[FloatArray, float]]:
    """The best pose (3,) and, best first, all elsewhere with ``rival_share`` of its score at least, with scores.

    At most ``most``; ``MAX_HYPOTHESES`` + 1 say that a place looks alike wherever one stands in it.
    """
    if not len(points_m):
        return []
    points = thin_evenly(points_m, MAX_POINTS)
    # the angle step moves the typical far point by one cell
    typical = int(FAR_SHARE * (len(points) - 1))
    reach = max(1.0, float(np.partition(np.hypot(points[:, 0], points[:, 1]), typical)[typical]))
    step = place.cell_m / reach
    n = math.ceil(half_window_rad / step)
    angles = np.arange(-n, n + 1) * step
    poses, scores = correlate.branch_and_bound(
        place.levels, place.origin_m, place.cell_m, points, center, angles, half_window_m, min_score,
        most, rival_share, ELSEWHERE_M,
    )  # fmt: skip
    return list(zip(poses, scores.tolist(), strict=True))


def thin_evenly(points_m: FloatArray, count: int) -> FloatArray:
    """At most ``count`` of the points, evenly taken."""
    if points_m.shape[0] <= count:
        return np.ascontiguousarray(points_m)
    return np.ascontiguousarray(points_m[np.linspace(0, points_m.shape[0] - 1, count).astype(np.int64)])
