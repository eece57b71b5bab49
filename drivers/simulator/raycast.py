"""Compiled loops of the simulator: poses on a chain of twists, rays against segments and discs."""

import math

import numpy as np
from numba import njit

from mfslam.types import FloatArray


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


@njit(cache=True, nogil=True, inline="always")
def _ray_segment(
    ox: float, oy: float, dx: float, dy: float, px: float, py: float, ex: float, ey: float, min_cos: float
) -> float:
    """Distance along the ray o + t d to the segment p + u e, or inf; d is a unit vector.

    ``min_cos``: the segment is invisible to rays farther from its normal than this cosine (glass).
    """
    cross = dx * ey - dy * ex
    if cross == 0.0:
        return math.inf
    wx, wy = px - ox, py - oy
    t = (wx * ey - wy * ex) / cross
    u = (wx * dy - wy * dx) / cross
    if t <= 0.0 or u < -1e-12 or u > 1.0 + 1e-12:  # closed ends: no ray slips through a corner
        return math.inf
    if min_cos > 0.0 and cross * cross < min_cos * min_cos * (ex * ex + ey * ey):
        return math.inf
    return t


@njit(cache=True, nogil=True, inline="always")
def _ray_circle(ox: float, oy: float, dx: float, dy: float, cx: float, cy: float, r: float) -> float:
    """Distance along the ray to the near side of a disc, or inf."""
    wx, wy = cx - ox, cy - oy
    along = wx * dx + wy * dy
    across = wx * dy - wy * dx
    inside = r * r - across * across
    if inside < 0.0:
        return math.inf
    t = along - math.sqrt(inside)
    return t if t > 0.0 else math.inf


@njit(cache=True, nogil=True, inline="always")
def _distance_to_segment(x: float, y: float, px: float, py: float, ex: float, ey: float) -> float:
    length2 = ex * ex + ey * ey
    u = ((x - px) * ex + (y - py) * ey) / length2 if length2 > 0.0 else 0.0
    u = min(max(u, 0.0), 1.0)
    return math.hypot(px + u * ex - x, py + u * ey - y)


@njit(cache=True, nogil=True)
def cast_beams(
    world_T_laser: FloatArray,
    bearings: FloatArray,
    segments: FloatArray,
    min_cos: FloatArray,
    circles: FloatArray,
    moving_segments: FloatArray,
    moving_circles: FloatArray,
    range_max: float,
) -> FloatArray:
    """True ranges (S, B) of S scans of B beams, inf beyond ``range_max``.

    ``world_T_laser`` (S, B, 3): the laser's pose at the instant of every beam. ``bearings`` (B,).
    ``segments`` (M, 4) x1 y1 x2 y2 with ``min_cos`` (M,); ``circles`` (C, 3) x y r.
    ``moving_segments`` (S, B, D, 4) and ``moving_circles`` (S, B, P, 3): where they are at every beam.
    """
    scans, beams = world_T_laser.shape[0], world_T_laser.shape[1]
    ranges = np.empty((scans, beams))
    near = np.empty((segments.shape[0], 5))
    near_circles = np.empty(circles.shape[0], np.int64)
    for i in range(scans):
        x0, y0 = world_T_laser[i, 0, 0], world_T_laser[i, 0, 1]
        reach = 0.0
        for j in range(beams):
            reach = max(reach, math.hypot(world_T_laser[i, j, 0] - x0, world_T_laser[i, j, 1] - y0))
        reach += range_max
        m = 0
        for k in range(segments.shape[0]):
            px, py = segments[k, 0], segments[k, 1]
            ex, ey = segments[k, 2] - px, segments[k, 3] - py
            if _distance_to_segment(x0, y0, px, py, ex, ey) <= reach:
                near[m, 0], near[m, 1], near[m, 2], near[m, 3], near[m, 4] = px, py, ex, ey, min_cos[k]
                m += 1
        c = 0
        for k in range(circles.shape[0]):
            if math.hypot(circles[k, 0] - x0, circles[k, 1] - y0) - circles[k, 2] <= reach:
                near_circles[c] = k
                c += 1
        for j in range(beams):
            ox, oy = world_T_laser[i, j, 0], world_T_laser[i, j, 1]
            heading = world_T_laser[i, j, 2] + bearings[j]
            dx, dy = math.cos(heading), math.sin(heading)
            best = math.inf
            for k in range(m):
                t = _ray_segment(ox, oy, dx, dy, near[k, 0], near[k, 1], near[k, 2], near[k, 3], near[k, 4])
                best = min(best, t)
            for k in range(c):
                n = near_circles[k]
                best = min(best, _ray_circle(ox, oy, dx, dy, circles[n, 0], circles[n, 1], circles[n, 2]))
            for k in range(moving_segments.shape[2]):
                px, py = moving_segments[i, j, k, 0], moving_segments[i, j, k, 1]
                ex, ey = moving_segments[i, j, k, 2] - px, moving_segments[i, j, k, 3] - py
                best = min(best, _ray_segment(ox, oy, dx, dy, px, py, ex, ey, 0.0))
            for k in range(moving_circles.shape[2]):
                q = moving_circles[i, j, k]
                best = min(best, _ray_circle(ox, oy, dx, dy, q[0], q[1], q[2]))
            ranges[i, j] = best if best <= range_max else math.inf
    return ranges
