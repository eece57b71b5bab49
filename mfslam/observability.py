"""Stretches of the path where scan matching left a direction open, so that something else decided there."""

from __future__ import annotations

import math

import numpy as np

from mfslam import se2
from mfslam.types import Edge, EdgeKind, FloatArray, IntArray, OpenStretch

OPEN_SIGMA_M = 0.1  # a match less sure than this along some direction leaves it open
GAP_M = 1.0  # stretches of one direction nearer than this are one
# a step less sure than this tears the path: what a scan fits there may be the next place that looks alike
TORN_M, TORN_RAD = 0.5, 0.5
SAME_DIRECTION_COS = 0.7  # of twice the angle: a stretch ends where its open direction turned by 23 deg


def open_stretches(world_T_keyframe: FloatArray, keyframes: IntArray, edges: list[Edge]) -> list[OpenStretch]:
    """Runs of keyframe steps whose scan match is less sure than `OPEN_SIGMA_M` in one and the same direction of
    the world, over gaps of up to `GAP_M`.

    ``world_T_keyframe`` (K, 3); ``keyframes`` (K,): their scans.
    """
    known = _steps_by(edges, ("scan", "ends"))
    if not known:
        return []
    ends = np.array(sorted(known))
    information = np.array([known[j] for j in ends.tolist()])
    # the turn is estimated too: what it leaves of the translation
    covariance = np.linalg.inv(information)[:, :2, :2]
    values, vectors = np.linalg.eigh(covariance)
    sigma_m = np.sqrt(values[:, 1].clip(min=0.0))
    along = np.arctan2(vectors[:, 1, 1], vectors[:, 0, 1]) + world_T_keyframe[ends, 2]
    lengths_m = np.hypot(*(world_T_keyframe[ends] - world_T_keyframe[ends - 1])[:, :2].T)
    axis = np.exp(2j * along)  # a direction and its opposite are the same
    travel_m = np.cumsum(lengths_m)
    runs: list[list[int]] = []
    for n in np.flatnonzero(sigma_m > OPEN_SIGMA_M).tolist():
        if runs:
            last = runs[-1][-1]
            mean = axis[runs[-1]].mean()
            same = (axis[n] * np.conj(mean)).real > SAME_DIRECTION_COS * abs(mean)
            if same and travel_m[n - 1] - travel_m[last] <= GAP_M:
                runs[-1].append(n)
                continue
        runs.append([n])
    return [
        OpenStretch(
            int(keyframes[ends[run[0]] - 1]),
            int(keyframes[ends[run[-1]]]),
            float(lengths_m[run[0] : run[-1] + 1].sum()),
            float(0.5 * np.angle(axis[run].mean())),
        )
        for run in runs
    ]


def _steps_by(edges: list[Edge], kinds: tuple[EdgeKind, ...]) -> dict[int, FloatArray]:
    """What edges of these kinds say together of each step between two keyframes: the later one, and information (3, 3)."""
    known: dict[int, FloatArray] = {}
    for edge in edges:
        if edge.kind in kinds and edge.j == edge.i + 1:
            known[edge.j] = known.get(edge.j, 1e-6 * np.eye(3)) + edge.information
    return known


def is_torn(covariance: FloatArray) -> bool:
    """Whether a step of this covariance (3, 3) tears the path."""
    (a, b, _), (_, d, _), (_, _, turn_rad2) = covariance.tolist()
    largest_m2 = 0.5 * (a + d) + math.hypot(0.5 * (a - d), b)
    return bool(largest_m2 > TORN_M**2 or turn_rad2 > TORN_RAD**2)


def tears(edges: list[Edge]) -> dict[int, FloatArray]:
    """Keyframes before which the path is torn, each with the covariance (3, 3) of the step to it: neither matches nor wheels
    tell that step, and no loop in use ties both sides."""
    known = _steps_by(edges, ("scan", "ends", "odometry", "heading"))
    if not known:
        return {}
    ends = np.array(sorted(known))
    covariances = np.linalg.inv(np.array([known[j] for j in ends.tolist()]))
    torn = np.array([is_torn(covariance) for covariance in covariances])
    for edge in edges:
        if edge.kind == "loop" and edge.weight >= 0.5:
            torn &= (ends <= min(edge.i, edge.j)) | (ends > max(edge.i, edge.j))
    return {int(ends[n]): covariances[n] for n in np.flatnonzero(torn)}


def torn_covariances(world_T_keyframe: FloatArray, edges: list[Edge]) -> FloatArray:
    """(K, 3, 3) what the tears before each keyframe (K, 3) add to its covariance, in its tangent."""
    out = np.zeros((len(world_T_keyframe), 3, 3))
    for k, covariance in tears(edges).items():
        carry = se2.adjoint(se2.between(world_T_keyframe[k:], world_T_keyframe[k : k + 1]))
        out[k:] += carry @ covariance @ np.swapaxes(carry, 1, 2)
    return out
