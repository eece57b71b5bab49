"""Poses between the knots of a track, and the mean motion over a part of it."""

import numpy as np

from mfslam.kernels.compiling import kernel
from mfslam.kernels.poses import between, interpolate, twist_to
from mfslam.types import FloatArray


@kernel
def pose_at(times_s: FloatArray, odom_T_body: FloatArray, count: int, time_s: float) -> FloatArray:
    """Pose (3,) at an instant: constant twist between the first ``count`` knots, held at both ends (eq. 16)."""
    low, high = 0, count  # the first knot after the instant, by halves
    while low < high:
        middle = (low + high) // 2
        if times_s[middle] > time_s:
            high = middle
        else:
            low = middle + 1
    if low == 0 or low == count:
        at_end: FloatArray = odom_T_body[max(0, low - 1)].copy()
        return at_end
    start_s = times_s[low - 1]
    share = (time_s - start_s) / (times_s[low] - start_s)
    pose: FloatArray = interpolate(odom_T_body[low - 1], odom_T_body[low], share)
    return pose


@kernel
def mean_twist(
    times_s: FloatArray, odom_T_body: FloatArray, count: int, start_s: float, end_s: float
) -> FloatArray:
    """Body twist (3,) per second that leads from the pose at one instant to that at another."""
    step = between(pose_at(times_s, odom_T_body, count, start_s), pose_at(times_s, odom_T_body, count, end_s))
    out = np.empty(3)
    out[0], out[1], out[2] = twist_to(step[0], step[1], step[2])
    return out / (end_s - start_s)
