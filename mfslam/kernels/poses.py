"""Single SE(2) poses in compiled code: what `mfslam.se2` does for arrays, at a microsecond a call."""

import math

import numpy as np

from mfslam.kernels.compiling import helper, kernel
from mfslam.types import FloatArray


@helper
def wrap_angle(angle: float) -> float:
    return math.pi - (math.pi - angle) % (2.0 * math.pi)


@helper
def arc(vx: float, vy: float, w: float) -> tuple[float, float, float]:
    """SE(2) exponential: where a twist held for unit time leads."""
    if abs(w) < 1e-9:
        return vx - 0.5 * w * vy, vy + 0.5 * w * vx, w
    # 1 - cos(w) would lose its digits in small turns
    half_sin = math.sin(0.5 * w)
    s, c = math.sin(w) / w, 2.0 * half_sin * half_sin / w
    return s * vx - c * vy, c * vx + s * vy, w


@helper
def after_arc(vx: float, vy: float, w: float, px: float, py: float) -> tuple[float, float]:
    """A point of the frame that a twist leads to (`arc`), seen from where it began."""
    chord, half_cos = chord_and_cosine(0.5 * w)
    half_sin = 0.5 * w * chord
    # the chord of the arc points along the heading halfway
    x, y = chord * (half_cos * vx - half_sin * vy), chord * (half_sin * vx + half_cos * vy)
    c, s = 1.0 - 2.0 * half_sin * half_sin, 2.0 * half_sin * half_cos
    return x + c * px - s * py, y + s * px + c * py


@helper
def chord_and_cosine(half: float) -> tuple[float, float]:
    """sin(h) / h, which is the chord of an arc of unit length that turns by 2 h, and cos(h).

    By their series where h is small, as it is within a scan: exact to the last digit, without a call or a branch for zero.
    """
    if abs(half) > 0.25:
        return math.sin(half) / half, math.cos(half)
    q = half * half
    chord = 1.0 - q * (1.0 / 6.0) * (
        1.0
        - q * (1.0 / 20.0) * (1.0 - q * (1.0 / 42.0) * (1.0 - q * (1.0 / 72.0) * (1.0 - q * (1.0 / 110.0))))
    )
    cosine = 1.0 - q * (1.0 / 2.0) * (
        1.0
        - q * (1.0 / 12.0) * (1.0 - q * (1.0 / 30.0) * (1.0 - q * (1.0 / 56.0) * (1.0 - q * (1.0 / 90.0))))
    )
    return chord, cosine


@kernel
def advance(w_T_a: FloatArray, twist: FloatArray, duration_s: float) -> FloatArray:
    """Pose after a body twist was held for a time: the exact arc."""
    x, y, turn = arc(twist[0] * duration_s, twist[1] * duration_s, twist[2] * duration_s)
    c, s = math.cos(w_T_a[2]), math.sin(w_T_a[2])
    out = np.empty(3)
    out[0] = w_T_a[0] + c * x - s * y
    out[1] = w_T_a[1] + s * x + c * y
    out[2] = wrap_angle(w_T_a[2] + turn)
    return out


@kernel
def compose(a_T_b: FloatArray, b_T_c: FloatArray) -> FloatArray:
    c, s = math.cos(a_T_b[2]), math.sin(a_T_b[2])
    out = np.empty(3)
    out[0] = a_T_b[0] + c * b_T_c[0] - s * b_T_c[1]
    out[1] = a_T_b[1] + s * b_T_c[0] + c * b_T_c[1]
    out[2] = wrap_angle(a_T_b[2] + b_T_c[2])
    return out


@kernel
def between(w_T_a: FloatArray, w_T_b: FloatArray) -> FloatArray:
    c, s = math.cos(w_T_a[2]), math.sin(w_T_a[2])
    dx, dy = w_T_b[0] - w_T_a[0], w_T_b[1] - w_T_a[1]
    out = np.empty(3)
    out[0] = c * dx + s * dy
    out[1] = -s * dx + c * dy
    out[2] = wrap_angle(w_T_b[2] - w_T_a[2])
    return out


@kernel
def off_in_sigmas(w_T_a: FloatArray, w_T_b: FloatArray, sigmas: FloatArray) -> float:
    """How far b stands from a, in ``sigmas`` (3,) of the worst direction of a."""
    step = between(w_T_a, w_T_b)
    worst = 0.0
    for d in range(3):
        worst = max(worst, abs(step[d]) / sigmas[d])
    return worst


@kernel
def transform_points(a_T_b: FloatArray, points: FloatArray, normals: FloatArray, out: FloatArray) -> None:
    """Points and normals (M, 2) of frame b, moved into rows x, y, nx, ny of ``out`` (M, 4) in frame a."""
    c, s = math.cos(a_T_b[2]), math.sin(a_T_b[2])
    for k in range(points.shape[0]):
        out[k, 0] = a_T_b[0] + c * points[k, 0] - s * points[k, 1]
        out[k, 1] = a_T_b[1] + s * points[k, 0] + c * points[k, 1]
        out[k, 2] = c * normals[k, 0] - s * normals[k, 1]
        out[k, 3] = s * normals[k, 0] + c * normals[k, 1]


@helper
def twist_to(x: float, y: float, theta: float) -> tuple[float, float, float]:
    """SE(2) logarithm: the twist that leads to a pose in unit time."""
    w = wrap_angle(theta)
    half = 0.5 * w
    half_cot = 1.0 - w * w / 12.0 if abs(w) < 1e-6 else half / math.tan(half)
    return half_cot * x + half * y, -half * x + half_cot * y, w


@kernel
def log(pose: FloatArray) -> FloatArray:
    """Twist that reaches a pose in unit time."""
    out = np.empty(3)
    out[0], out[1], out[2] = twist_to(pose[0], pose[1], pose[2])
    return out


@kernel
def interpolate(w_T_a: FloatArray, w_T_b: FloatArray, share: float) -> FloatArray:
    """Pose at ``share`` of the constant-twist path from a (0) to b (1)."""
    pose: FloatArray = advance(w_T_a, log(between(w_T_a, w_T_b)), share)
    return pose
