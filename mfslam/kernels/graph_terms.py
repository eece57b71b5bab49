"""What the edges of a pose graph say of its poses: residuals, and the normal equations in the pattern of their factor."""

import math

import numpy as np

from mfslam.kernels.compiling import helper, kernel
from mfslam.kernels.poses import arc, wrap_angle
from mfslam.types import FloatArray, IntArray


@helper
def _residual(measured: FloatArray, e: int, poses: FloatArray, i: int, j: int, out: FloatArray) -> None:
    """log(measured^-1 i_T_j) into ``out[:3]``, sine and cosine of i_T_j, its x and y into ``out[3:7]``. An edge of one pose
    (i = j) measures it in the world."""
    if i == j:
        x, y, theta = poses[j, 0], poses[j, 1], poses[j, 2]
    else:
        c, s = math.cos(poses[i, 2]), math.sin(poses[i, 2])
        dx, dy = poses[j, 0] - poses[i, 0], poses[j, 1] - poses[i, 1]
        x, y, theta = c * dx + s * dy, -s * dx + c * dy, poses[j, 2] - poses[i, 2]
    out[3], out[4], out[5], out[6] = math.sin(theta), math.cos(theta), x, y
    c, s = math.cos(measured[e, 2]), math.sin(measured[e, 2])
    dx, dy = x - measured[e, 0], y - measured[e, 1]
    x, y, w = c * dx + s * dy, -s * dx + c * dy, wrap_angle(theta - measured[e, 2])
    half = 0.5 * w
    half_cot = 1.0 - w * w / 12.0 if abs(w) < 1e-4 else half / math.tan(half)
    out[0], out[1], out[2] = half_cot * x + half * y, -half * x + half_cot * y, w


@helper
def _chi2(information: FloatArray, e: int, r: FloatArray) -> float:
    total = 0.0
    for u in range(3):
        for v in range(3):
            total += r[u] * information[e, u, v] * r[v]
    return total


@kernel
def edge_chi2(ends: IntArray, measured: FloatArray, information: FloatArray, poses: FloatArray) -> FloatArray:
    """(E,) chi2 of every edge at ``poses`` (K, 3); ``ends`` (E, 2) keyframes, ``measured`` (E, 3)."""
    out = np.empty(ends.shape[0])
    r = np.empty(7)
    for e in range(ends.shape[0]):
        _residual(measured, e, poses, ends[e, 0], ends[e, 1], r)
        out[e] = _chi2(information, e, r)
    return out


@kernel
def normal_equations(
    ends: IntArray,
    measured: FloatArray,
    information: FloatArray,
    weights: FloatArray,
    poses: FloatArray,
    place: IntArray,
    slots: IntArray,
    damping: float,
    diagonal: FloatArray,
    below: FloatArray,
    rhs: FloatArray,
) -> None:
    """H and -gradient of the sum of ``weights`` (E,) times chi2, by right perturbations of the poses.

    ``place`` (K,): the row of each pose, -1 for one that is held. ``slots`` (E,): where the block of an edge's two
    poses stands in ``below`` (rows of the one that comes later). ``damping`` is added to the diagonal.
    """
    for n in range(diagonal.shape[0]):
        for u in range(3):
            rhs[n, u] = 0.0
            for v in range(3):
                diagonal[n, u, v] = damping if u == v else 0.0
    for q in range(below.shape[0]):
        for u in range(3):
            for v in range(3):
                below[q, u, v] = 0.0
    r = np.empty(7)
    jacobian = np.zeros((2, 3, 3))  # by pose i, by pose j
    weighted = np.empty((2, 3, 3))
    at = np.empty(2, np.int64)
    for e in range(ends.shape[0]):
        weight = weights[e]
        if weight == 0.0:
            continue
        i, j = ends[e, 0], ends[e, 1]
        _residual(measured, e, poses, i, j, r)
        w = r[2]
        half = 0.5 * w
        # dlog = A R(w) for the translation; the turn moves it by A'(w) p, p the translation of the error
        if abs(w) < 1e-4:
            cot, slope = 1.0 - w * w / 12.0, -w / 6.0
        else:
            tan, sin = math.tan(half), math.sin(half)
            cot, slope = half / tan, 0.5 / tan - 0.5 * half / (sin * sin)
        inverse = 1.0 / (cot * cot + half * half)
        px, py = inverse * (cot * r[0] - half * r[1]), inverse * (half * r[0] + cot * r[1])
        c, s = math.cos(w), math.sin(w)
        jacobian[1, 0, 0], jacobian[1, 0, 1] = cot * c + half * s, -cot * s + half * c
        jacobian[1, 1, 0], jacobian[1, 1, 1] = -half * c + cot * s, half * s + cot * c
        jacobian[1, 0, 2], jacobian[1, 1, 2] = slope * px + 0.5 * py, -0.5 * px + slope * py
        jacobian[1, 2, 2] = 1.0
        # by pose i: -dlog Ad(j_T_i), with the turn -theta and the translation -R^T t
        sin, cos, x, y = r[3], r[4], r[5], r[6]
        for u in range(3):
            a, b = jacobian[1, u, 0], jacobian[1, u, 1]
            jacobian[0, u, 0] = -(cos * a - sin * b)
            jacobian[0, u, 1] = -(sin * a + cos * b)
            jacobian[0, u, 2] = -(a * (sin * x - cos * y) + b * (cos * x + sin * y) + jacobian[1, u, 2])
        at[0], at[1] = place[i], place[j]
        if i == j:
            at[0] = -1
        for k in range(2):
            if at[k] < 0:
                continue
            for u in range(3):
                for v in range(3):
                    weighted[k, u, v] = weight * (
                        jacobian[k, 0, u] * information[e, 0, v]
                        + jacobian[k, 1, u] * information[e, 1, v]
                        + jacobian[k, 2, u] * information[e, 2, v]
                    )
                rhs[at[k], u] -= (
                    weighted[k, u, 0] * r[0] + weighted[k, u, 1] * r[1] + weighted[k, u, 2] * r[2]
                )
            for u in range(3):
                for v in range(3):
                    diagonal[at[k], u, v] += (
                        weighted[k, u, 0] * jacobian[k, 0, v]
                        + weighted[k, u, 1] * jacobian[k, 1, v]
                        + weighted[k, u, 2] * jacobian[k, 2, v]
                    )
        if at[0] < 0 or at[1] < 0:
            continue
        high = 0 if at[0] > at[1] else 1
        q = slots[e]
        for u in range(3):
            for v in range(3):
                below[q, u, v] += (
                    weighted[high, u, 0] * jacobian[1 - high, 0, v]
                    + weighted[high, u, 1] * jacobian[1 - high, 1, v]
                    + weighted[high, u, 2] * jacobian[1 - high, 2, v]
                )


@kernel
def moved_poses(poses: FloatArray, place: IntArray, step: FloatArray) -> FloatArray:
    """(K, 3) poses after right perturbations ``step``, by rows of the equations (`place`)."""
    out = poses.copy()
    for k in range(poses.shape[0]):
        n = place[k]
        if n < 0:
            continue
        x, y, w = arc(step[n, 0], step[n, 1], step[n, 2])
        c, s = math.cos(poses[k, 2]), math.sin(poses[k, 2])
        out[k, 0] = poses[k, 0] + c * x - s * y
        out[k, 1] = poses[k, 1] + s * x + c * y
        out[k, 2] = wrap_angle(poses[k, 2] + w)
    return out
