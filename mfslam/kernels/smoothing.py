"""Smoothing of one coordinate of a motion whose acceleration wanders: white noise on the jerk.

The state is position, velocity and acceleration; a Kalman filter forward and the smoother of Rauch and others
(1965) back. What lies between two instants whose states are known is a polynomial of fifth order (a Gaussian process
prior: Barfoot, Tong and Sarkka 2014).
"""

import math

import numpy as np

from mfslam.kernels.compiling import helper, kernel
from mfslam.kernels.matrices import cholesky_root, solve_by_root
from mfslam.types import BoolArray, FloatArray

UNKNOWN_VELOCITY, UNKNOWN_ACCELERATION = 100.0, 100.0  # variances before anything is known


@helper
def _carry(dt: float, state: FloatArray, cov: FloatArray, phi_cov: FloatArray) -> None:
    """State (3,) and covariance (3, 3) after ``dt`` s without noise, in place; ``phi_cov``: transition times covariance."""
    half = 0.5 * dt * dt
    state[0] += dt * state[1] + half * state[2]
    state[1] += dt * state[2]
    for u in range(3):
        phi_cov[0, u] = cov[0, u] + dt * cov[1, u] + half * cov[2, u]
        phi_cov[1, u] = cov[1, u] + dt * cov[2, u]
        phi_cov[2, u] = cov[2, u]
    for u in range(3):
        cov[u, 0] = phi_cov[u, 0] + dt * phi_cov[u, 1] + half * phi_cov[u, 2]
        cov[u, 1] = phi_cov[u, 1] + dt * phi_cov[u, 2]
        cov[u, 2] = phi_cov[u, 2]


@helper
def _add_noise(dt: float, jerk: float, cov: FloatArray) -> None:
    """What white noise of spectral density ``jerk`` on the third derivative adds to a covariance (3, 3) in ``dt`` s."""
    cov[0, 0] += jerk * dt**5 / 20.0
    cov[0, 1] += jerk * dt**4 / 8.0
    cov[0, 2] += jerk * dt**3 / 6.0
    cov[1, 1] += jerk * dt**3 / 3.0
    cov[1, 2] += jerk * dt * dt / 2.0
    cov[2, 2] += jerk * dt
    cov[1, 0], cov[2, 0], cov[2, 1] = cov[0, 1], cov[0, 2], cov[1, 2]


@kernel
def run_forward(
    times: FloatArray,
    position: FloatArray,
    variance: FloatArray,
    begins: BoolArray,
    jerk: float,
    states: FloatArray,
    covariances: FloatArray,
) -> float:
    """Filter measured positions (N,) with variances (N,): fill ``states`` (N, 3) and ``covariances`` (N, 3, 3).

    ``times`` (N,) must not decrease. ``begins`` (N,): nothing is known of how it came there from the one before.
    Returns minus twice the log likelihood of the positions, less a constant.
    """
    cost = 0.0
    state, cov, scratch = np.empty(3), np.empty((3, 3)), np.empty((3, 3))
    for n in range(times.shape[0]):
        if n == 0 or begins[n]:
            for u in range(3):
                state[u] = 0.0
                for v in range(3):
                    cov[u, v] = 0.0
            state[0], cov[0, 0] = position[n], variance[n]
            cov[1, 1], cov[2, 2] = UNKNOWN_VELOCITY, UNKNOWN_ACCELERATION
        else:
            dt = times[n] - times[n - 1]
            _carry(dt, state, cov, scratch)
            _add_noise(dt, jerk, cov)
            spread = cov[0, 0] + variance[n]
            off = position[n] - state[0]
            cost += off * off / spread + math.log(spread)
            g0, g1, g2 = cov[0, 0] / spread, cov[0, 1] / spread, cov[0, 2] / spread
            state[0] += g0 * off
            state[1] += g1 * off
            state[2] += g2 * off
            c0, c1, c2 = cov[0, 0], cov[0, 1], cov[0, 2]
            cov[0, 0] -= g0 * c0
            cov[0, 1] -= g0 * c1
            cov[0, 2] -= g0 * c2
            cov[1, 1] -= g1 * c1
            cov[1, 2] -= g1 * c2
            cov[2, 2] -= g2 * c2
            cov[1, 0], cov[2, 0], cov[2, 1] = cov[0, 1], cov[0, 2], cov[1, 2]
        for u in range(3):
            states[n, u] = state[u]
            for v in range(3):
                covariances[n, u, v] = cov[u, v]
    return cost


@kernel
def run_back(
    times: FloatArray, begins: BoolArray, jerk: float, states: FloatArray, covariances: FloatArray
) -> None:
    """Smooth what `run_forward` has filled, in place."""
    state, cov, scratch = np.empty(3), np.empty((3, 3)), np.empty((3, 3))
    gain, root = np.empty((3, 3)), np.empty((3, 3))
    for n in range(times.shape[0] - 2, -1, -1):
        if begins[n + 1]:
            continue
        for u in range(3):
            state[u] = states[n, u]
            for v in range(3):
                cov[u, v] = covariances[n, u, v]
        dt = times[n + 1] - times[n]
        _carry(dt, state, cov, scratch)
        _add_noise(dt, jerk, cov)
        if not cholesky_root(cov, root):
            continue  # nothing is learnt from what comes after
        for u in range(3):
            for v in range(3):
                gain[u, v] = scratch[v, u]
            solve_by_root(root, gain[u])
            for v in range(3):
                cov[u, v] = covariances[n + 1, u, v] - cov[u, v]
                states[n, u] += gain[u, v] * (states[n + 1, v] - state[v])
        _add_turned(gain, cov, covariances, n)


@helper
def _add_turned(gain: FloatArray, change: FloatArray, covariances: FloatArray, n: int) -> None:
    """covariances[n] += gain change gain^T of a symmetric ``change`` (3, 3)."""
    for u in range(3):
        g0 = gain[u, 0] * change[0, 0] + gain[u, 1] * change[1, 0] + gain[u, 2] * change[2, 0]
        g1 = gain[u, 0] * change[0, 1] + gain[u, 1] * change[1, 1] + gain[u, 2] * change[2, 1]
        g2 = gain[u, 0] * change[0, 2] + gain[u, 1] * change[1, 2] + gain[u, 2] * change[2, 2]
        for v in range(u + 1):
            covariances[n, u, v] += g0 * gain[v, 0] + g1 * gain[v, 1] + g2 * gain[v, 2]
            covariances[n, v, u] = covariances[n, u, v]
