"""SE(2) on (..., 3) arrays.

Group: planar rigid motions. Storage: (x, y, theta), metres and radians, theta wrapped to (-pi, pi].
Tangent: (vx, vy, omega), right-perturbation ``T exp(xi)``: the order and the exponential of gtsam.Pose2.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from mfslam.types import FloatArray

LARGEST = (
    1e9  # m or rad that a pose may have: no planet is larger, and far larger numbers overflow when squared
)


def are_of_a_pose(numbers: Iterable[float]) -> bool:
    """Whether all are finite and of a size that a pose can have."""
    return all(abs(number) <= LARGEST for number in numbers)


def wrap(angle_rad: FloatArray | float) -> FloatArray:
    """Angle on (-pi, pi]."""
    return np.asarray(np.pi - np.mod(np.pi - np.asarray(angle_rad, dtype=np.float64), 2.0 * np.pi))


def compose(a_T_b: FloatArray, b_T_c: FloatArray) -> FloatArray:
    """a_T_c, (..., 3); shapes broadcast."""
    a, b = np.asarray(a_T_b, dtype=np.float64), np.asarray(b_T_c, dtype=np.float64)
    c, s = np.cos(a[..., 2]), np.sin(a[..., 2])
    x = a[..., 0] + c * b[..., 0] - s * b[..., 1]
    y = a[..., 1] + s * b[..., 0] + c * b[..., 1]
    return np.stack([x, y, wrap(a[..., 2] + b[..., 2])], axis=-1)


def inverse(a_T_b: FloatArray) -> FloatArray:
    """b_T_a."""
    a = np.asarray(a_T_b, dtype=np.float64)
    c, s = np.cos(a[..., 2]), np.sin(a[..., 2])
    return np.stack(
        [-c * a[..., 0] - s * a[..., 1], s * a[..., 0] - c * a[..., 1], wrap(-a[..., 2])], axis=-1
    )


def between(w_T_a: FloatArray, w_T_b: FloatArray) -> FloatArray:
    """a_T_b of two poses in one frame."""
    a, b = np.asarray(w_T_a, dtype=np.float64), np.asarray(w_T_b, dtype=np.float64)
    c, s = np.cos(a[..., 2]), np.sin(a[..., 2])
    dx, dy = b[..., 0] - a[..., 0], b[..., 1] - a[..., 1]
    return np.stack([c * dx + s * dy, -s * dx + c * dy, wrap(b[..., 2] - a[..., 2])], axis=-1)


def exp(twist: FloatArray) -> FloatArray:
    """Pose reached by holding ``twist`` (..., 3) for unit time: the exact arc."""
    xi = np.asarray(twist, dtype=np.float64)
    w = xi[..., 2]
    small = np.abs(w) < 1e-6
    safe = np.where(small, 1.0, w)
    sin_w = np.where(small, 1.0 - w * w / 6.0, np.sin(safe) / safe)
    cos_w = np.where(small, 0.5 * w, 2.0 * np.sin(0.5 * safe) ** 2 / safe)  # 1 - cos without its cancellation
    x = sin_w * xi[..., 0] - cos_w * xi[..., 1]
    y = cos_w * xi[..., 0] + sin_w * xi[..., 1]
    return np.stack([x, y, wrap(w)], axis=-1)


def log(pose: FloatArray) -> FloatArray:
    """Twist that reaches ``pose`` (..., 3) in unit time; inverse of `exp` for \\|theta\\| < pi."""
    p = np.asarray(pose, dtype=np.float64)
    w = wrap(p[..., 2])
    half = 0.5 * w
    small = np.abs(w) < 1e-6
    safe = np.where(small, 1.0, half)
    half_cot = np.where(small, 1.0 - w * w / 12.0, safe / np.tan(safe))
    x = half_cot * p[..., 0] + half * p[..., 1]
    y = -half * p[..., 0] + half_cot * p[..., 1]
    return np.stack([x, y, w], axis=-1)


def interpolate(w_T_a: FloatArray, w_T_b: FloatArray, fraction: FloatArray | float) -> FloatArray:
    """Pose at ``fraction`` of the constant-twist path from a (0) to b (1); eq. 16 made exact."""
    f = np.asarray(fraction, dtype=np.float64)[..., None]
    return compose(w_T_a, exp(f * log(between(w_T_a, w_T_b))))


def transform(a_T_b: FloatArray, points_b: FloatArray) -> FloatArray:
    """Points (..., N, 2) from frame b into frame a, a_T_b (..., 3)."""
    a, p = np.asarray(a_T_b, dtype=np.float64), np.asarray(points_b, dtype=np.float64)
    c, s = np.cos(a[..., 2, None]), np.sin(a[..., 2, None])
    return np.stack(
        [
            c * p[..., 0] - s * p[..., 1] + a[..., 0, None],
            s * p[..., 0] + c * p[..., 1] + a[..., 1, None],
        ],
        axis=-1,
    )


def adjoint(a_T_b: FloatArray) -> FloatArray:
    """(..., 3, 3): carries a twist of frame b into frame a, ``exp(Ad xi) T = T exp(xi)``."""
    a = np.asarray(a_T_b, dtype=np.float64)
    c, s = np.cos(a[..., 2]), np.sin(a[..., 2])
    zero, one = np.zeros_like(c), np.ones_like(c)
    return np.stack(
        [
            np.stack([c, -s, a[..., 1]], axis=-1),
            np.stack([s, c, -a[..., 0]], axis=-1),
            np.stack([zero, zero, one], axis=-1),
        ],
        axis=-2,
    )
