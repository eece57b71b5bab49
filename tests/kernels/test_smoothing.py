"""The smoother of one coordinate against one solution for all states at once."""

import numpy as np

from mfslam.kernels.smoothing import UNKNOWN_ACCELERATION, UNKNOWN_VELOCITY, run_back, run_forward


def test_smoothed_states_are_those_of_all_measurements_at_once():
    rng = np.random.default_rng(5)
    times = np.cumsum(rng.uniform(0.05, 0.2, 12))
    position, variance, jerk = np.sin(times) + rng.normal(0.0, 0.01, 12), np.full(12, 1e-4), 2.0
    begins = np.zeros(12, np.bool_)
    begins[7] = True
    states, covariances = np.empty((12, 3)), np.empty((12, 3, 3))
    run_forward(times, position, variance, begins, jerk, states, covariances)
    run_back(times, begins, jerk, states, covariances)

    information, rhs = np.zeros((36, 36)), np.zeros(36)
    for n in range(12):
        here = slice(3 * n, 3 * n + 3)
        information[3 * n, 3 * n] += 1.0 / variance[n]
        rhs[3 * n] += position[n] / variance[n]
        if n == 0 or begins[n]:
            information[here, here] += np.diag([0.0, 1.0 / UNKNOWN_VELOCITY, 1.0 / UNKNOWN_ACCELERATION])
            continue
        t = times[n] - times[n - 1]
        change = np.hstack([-np.array([[1.0, t, 0.5 * t * t], [0.0, 1.0, t], [0.0, 0.0, 1.0]]), np.eye(3)])
        noise = jerk * np.array(
            [[t**5 / 20, t**4 / 8, t**3 / 6], [t**4 / 8, t**3 / 3, t**2 / 2], [t**3 / 6, t**2 / 2, t]]
        )
        both = slice(3 * n - 3, 3 * n + 3)
        information[both, both] += change.T @ np.linalg.solve(noise, change)
    covariance = np.linalg.inv(information)
    np.testing.assert_allclose(states.ravel(), covariance @ rhs, rtol=1e-6, atol=1e-8)
    for n in range(12):
        block = covariance[3 * n : 3 * n + 3, 3 * n : 3 * n + 3]
        np.testing.assert_allclose(covariances[n], block, rtol=1e-6, atol=1e-9)
