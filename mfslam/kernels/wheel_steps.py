"""Steps of wheels: the law of their systematic errors (`mfslam.wheel_errors`) and their noise (`mfslam.odometry`)."""

import math

import numpy as np

from mfslam.kernels.compiling import helper, kernel
from mfslam.kernels.poses import arc, compose, twist_to, wrap_angle
from mfslam.types import FloatArray


@helper
def _true_twist(x: float, y: float, theta: float, errors: FloatArray) -> tuple[float, float, float]:
    scale, turn_scale, drift = errors[0], errors[1], errors[2]
    return (1.0 + scale) * x, (1.0 + scale) * y, (1.0 + turn_scale) * theta + drift * x


@helper
def _told_twist(x: float, y: float, theta: float, errors: FloatArray) -> tuple[float, float, float]:
    scale, turn_scale, drift = errors[0], errors[1], errors[2]
    x, y = x / (1.0 + scale), y / (1.0 + scale)
    return x, y, (theta - drift * x) / (1.0 + turn_scale)


@kernel
def true_twists(told: FloatArray, errors: FloatArray) -> FloatArray:
    """(N, 3) of true steps, of those told (N, 3) by wheels with ``errors`` (N, 3)."""
    out = np.empty(told.shape)
    for k in range(told.shape[0]):
        out[k, 0], out[k, 1], out[k, 2] = _true_twist(told[k, 0], told[k, 1], told[k, 2], errors[k])
    return out


@kernel
def told_twists(true: FloatArray, errors: FloatArray) -> FloatArray:
    """(N, 3) the inverse of `true_twists`."""
    out = np.empty(true.shape)
    for k in range(true.shape[0]):
        out[k, 0], out[k, 1], out[k, 2] = _told_twist(true[k, 0], true[k, 1], true[k, 2], errors[k])
    return out


@helper
def _true_step(told: FloatArray, errors: FloatArray, out: FloatArray) -> None:
    x, y, theta = twist_to(told[0], told[1], told[2])
    x, y, theta = _true_twist(x, y, theta, errors)
    x, y, theta = arc(x, y, theta)
    out[0], out[1], out[2] = x, y, wrap_angle(theta)


@kernel
def true_step(told: FloatArray, errors: FloatArray) -> FloatArray:
    """(3,) the true step of one that is told (3,) by wheels with ``errors`` (3,)."""
    out = np.empty(3)
    _true_step(told, errors, out)
    return out


@kernel
def advance_by_told(w_T_a: FloatArray, told: FloatArray, errors: FloatArray) -> FloatArray:
    """Pose (3,) after the true step of one that is told (3,), from ``w_T_a`` (3,)."""
    step = np.empty(3)
    _true_step(told, errors, step)
    pose: FloatArray = compose(w_T_a, step)
    return pose


@kernel
def told_steps(true: FloatArray, errors: FloatArray) -> FloatArray:
    """(N, 3) what wheels with ``errors`` (N, 3) tell of true steps (N, 3): the inverse of `true_step`."""
    out = np.empty(true.shape)
    for k in range(true.shape[0]):
        x, y, theta = twist_to(true[k, 0], true[k, 1], true[k, 2])
        x, y, theta = _told_twist(x, y, theta, errors[k])
        x, y, theta = arc(x, y, theta)
        out[k, 0], out[k, 1], out[k, 2] = x, y, wrap_angle(theta)
    return out


@helper
def _step_sigmas(step: FloatArray, noise: FloatArray, out: FloatArray) -> None:
    distance_m, turn_rad = math.hypot(step[0], step[1]), abs(step[2])
    for d in range(3):
        out[d] = noise[d, 0] + noise[d, 1] * distance_m + noise[d, 2] * turn_rad


@kernel
def step_sigmas(step: FloatArray, noise: FloatArray) -> FloatArray:
    """(3,) one sigma of a step (3,); ``noise`` as in `OdometryConfig.step_noise`."""
    out = np.empty(3)
    _step_sigmas(step, noise, out)
    return out


@kernel
def weigh_steps(
    told: FloatArray,
    matched: FloatArray,
    match_variances: FloatArray,
    shares: FloatArray,
    errors: FloatArray,
    noise: FloatArray,
    contradiction_sigmas: float,
) -> tuple[FloatArray, FloatArray]:
    """True steps (N, 3) and their information (N, 3, 3), of those ``told`` (N, 3) by wheels with ``errors`` (3,).

    ``shares`` (N, 3): variance over that of ``noise`` (`OdometryConfig.step_noise`). Steps that are farther off those
    ``matched`` (N, 3) than so many sigmas of both are believed as little as they are off.
    """
    n = told.shape[0]
    steps, information, sigmas = np.empty((n, 3)), np.zeros((n, 3, 3)), np.empty(3)
    for k in range(n):
        _true_step(told[k], errors, steps[k])
        _step_sigmas(steps[k], noise, sigmas)
        for d in range(3):
            variance = shares[k, d] * sigmas[d] * sigmas[d]
            off = (matched[k, d] - steps[k, d]) ** 2
            if off > contradiction_sigmas**2 * (variance + match_variances[k, d]):
                variance += off
            information[k, d, d] = 1.0 / variance
    return steps, information
