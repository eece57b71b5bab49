"""Compiled: poses on a chain of constant twists."""

import math

import numpy as np
from numba import njit

from mfslam.types import FloatArray


@njit(cache=True, nogil=True)
def chained(
    start: FloatArray, steps: FloatArray, headings: FloatArray, c: FloatArray, s: FloatArray
) -> FloatArray:
    """Poses (K+1, 3) from ``start`` (3,) by ``steps`` (K, 3), one after the other.

    ``headings`` (K+1,) with ``c`` and ``s`` (K,), cosine and sine of the first K.
    """
    out = np.empty((steps.shape[0] + 1, 3))
    out[0] = start
    for k in range(steps.shape[0]):
        out[k + 1, 0] = out[k, 0] + c[k] * steps[k, 0] - s[k] * steps[k, 1]
        out[k + 1, 1] = out[k, 1] + s[k] * steps[k, 0] + c[k] * steps[k, 1]
        out[k + 1, 2] = headings[k + 1]
    return out


@njit(cache=True, nogil=True)
def chained_headings(start: float, turns: FloatArray) -> FloatArray:
    """Headings (K+1,) on (-pi, pi] from ``start`` by ``turns`` (K,), one after the other."""
    out = np.empty(turns.shape[0] + 1)
    out[0] = start
    for k in range(turns.shape[0]):
        out[k + 1] = math.pi - (math.pi - (out[k] + turns[k])) % (2.0 * math.pi)
    return out


@njit(cache=True, nogil=True)
def poses_on_twists(
    times: FloatArray, knot_times: FloatArray, knot_poses: FloatArray, twists: FloatArray
) -> FloatArray:
    """Poses (N, 3) at ``times`` (N,) of a body that holds ``twists`` (K, 3) between ``knot_times`` (K+1,).

    The exact arc from the knot before; at rest outside the knots. Theta on (-pi, pi].
    """
    out = np.empty((times.shape[0], 3))
    last = twists.shape[0] - 1
    k = 0
    for i in range(times.shape[0]):
        t = min(max(times[i], knot_times[0]), knot_times[last + 1])
        if not (knot_times[k] <= t <= knot_times[min(k + 4, last + 1)]):  # far off: bisect
            k = min(max(np.searchsorted(knot_times, t, side="right") - 1, 0), last)
        while k < last and knot_times[k + 1] <= t:
            k += 1
        dt = t - knot_times[k]
        turn = twists[k, 2] * dt
        if abs(turn) < 1e-6:
            a, b = 1.0 - turn * turn / 6.0, 0.5 * turn
        else:
            a, b = math.sin(turn) / turn, 2.0 * math.sin(0.5 * turn) ** 2 / turn
        forward = (a * twists[k, 0] - b * twists[k, 1]) * dt
        left = (b * twists[k, 0] + a * twists[k, 1]) * dt
        c, s = math.cos(knot_poses[k, 2]), math.sin(knot_poses[k, 2])
        out[i, 0] = knot_poses[k, 0] + c * forward - s * left
        out[i, 1] = knot_poses[k, 1] + s * forward + c * left
        theta = knot_poses[k, 2] + turn
        out[i, 2] = math.pi - (math.pi - theta) % (2.0 * math.pi)
    return out
