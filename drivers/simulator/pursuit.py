"""A path to drive and how it is driven: rounded corners, speed limits from curvature, pure pursuit."""

import math

import numpy as np
from numba import njit

from mfslam.types import FloatArray

SAMPLE_M = 0.05
CREEP_M_S = 0.1  # it drives no slower, short of braking
ROUNDING_M = 0.8  # a corner is rounded over about this length before and after it
BRAKING_SHARE = 0.7  # of the acceleration: what the speed profile counts on, the rest is reserve


def rounded_path(points_m: FloatArray, speeds_m_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Samples (N, 2) every few cm along the polyline (W, 2), corners rounded, and speed limits (N,)."""
    lengths = np.hypot(*np.diff(points_m, axis=0).T)
    along = np.concatenate([[0.0], np.cumsum(lengths)])
    n = max(int(along[-1] / SAMPLE_M), 2)
    s = np.linspace(0.0, along[-1], n + 1)
    path = np.stack([np.interp(s, along, points_m[:, i]) for i in (0, 1)], axis=-1)
    limits = speeds_m_s[1:][np.clip(np.searchsorted(along, s, side="left") - 1, 0, len(lengths) - 1)]
    width = int(ROUNDING_M / SAMPLE_M) | 1
    kernel = np.full(width, 1.0 / width)
    for _ in range(2):  # a box twice: curvature rises and falls linearly
        ends = (np.tile(path[0], (width // 2, 1)), np.tile(path[-1], (width // 2, 1)))
        padded = np.concatenate([ends[0], path, ends[1]])
        path = np.stack([np.convolve(padded[:, i], kernel, "valid") for i in (0, 1)], axis=-1)
    return path, limits


def speed_profile(
    path: FloatArray,
    limits: FloatArray,
    acceleration: float,
    lateral_acceleration: float,
    max_yaw_rate: float,
    yaw_acceleration: float,
) -> tuple[FloatArray, FloatArray]:
    """Arc length (N,) and highest speed (N,) at each sample that keeps every limit and can still brake."""
    steps = np.diff(path, axis=0)
    ds = np.maximum(np.hypot(steps[:, 0], steps[:, 1]), 1e-6)
    s = np.concatenate([[0.0], np.cumsum(ds)])
    heading = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
    curvature = np.abs(np.gradient(np.append(heading, heading[-1]), s))
    change = np.abs(np.gradient(curvature, s))
    speed = np.minimum(limits, np.sqrt(lateral_acceleration / np.maximum(curvature, 1e-9)))
    speed = np.minimum(speed, 0.9 * max_yaw_rate / np.maximum(curvature, 1e-9))
    speed = np.minimum(speed, np.sqrt(yaw_acceleration / np.maximum(change, 1e-9)))
    speed = np.maximum(speed, CREEP_M_S)
    speed[-1] = 0.0
    for i in range(len(ds) - 1, -1, -1):
        speed[i] = min(speed[i], math.sqrt(speed[i + 1] ** 2 + 2.0 * BRAKING_SHARE * acceleration * ds[i]))
    return s, speed


@njit(cache=True, nogil=True)
def follow(
    path: FloatArray,
    s: FloatArray,
    speed: FloatArray,
    start: FloatArray,
    dt: float,
    acceleration: float,
    max_yaw_rate: float,
    yaw_acceleration: float,
    max_steps: int,
) -> FloatArray:
    """Twists (K, 3), one per ``dt``, of a robot that starts at rest at ``start``, pursues the path and stops.

    K is ``max_steps`` when it did not arrive. Farther off its course than 60 deg it turns in place.
    """
    twists = np.zeros((max_steps, 3))
    x, y, theta, v, w = start[0], start[1], start[2], 0.0, 0.0
    n = path.shape[0]
    i, k = 0, 0
    arrived = False
    while k < max_steps and not (arrived and v == 0.0 and w == 0.0):
        look = 0.25 + 0.15 * v
        closest, j = math.inf, i
        while j < n and s[j] <= s[i] + look:  # the last of the closest: a path may turn back on itself
            d = math.hypot(path[j, 0] - x, path[j, 1] - y)
            if d <= closest:
                closest, i = d, j
            j += 1
        arrived = arrived or s[n - 1] - s[i] < 0.03
        target = i
        while target < n - 1 and s[target] < s[i] + look:
            target += 1
        dx, dy = path[target, 0] - x, path[target, 1] - y
        off = math.pi - (math.pi - (math.atan2(dy, dx) - theta)) % (2.0 * math.pi)
        if arrived:
            v_goal, w_goal = 0.0, 0.0
        elif abs(off) > 1.05:
            v_goal = 0.0
            w_goal = math.copysign(min(max_yaw_rate, math.sqrt(yaw_acceleration * abs(off))), off)
        else:
            v_goal = max(speed[i], CREEP_M_S)
            w_goal = 2.0 * v * math.sin(off) / max(math.hypot(dx, dy), 0.05)
            w_goal += 2.0 * off * max(0.0, 1.0 - 2.0 * v)  # at walking pace also turn towards the target
        v += min(max(v_goal - v, -acceleration * dt), acceleration * dt)
        w_goal = min(max(w_goal, -max_yaw_rate), max_yaw_rate)
        w += min(max(w_goal - w, -yaw_acceleration * dt), yaw_acceleration * dt)
        twists[k, 0], twists[k, 2] = v, w
        half = theta + 0.5 * w * dt  # good enough to steer by; the truth is integrated exactly elsewhere
        x += v * dt * math.cos(half)
        y += v * dt * math.sin(half)
        theta += w * dt
        k += 1
    return twists[:k]
