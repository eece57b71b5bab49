"""Robust Gauss-Newton for wheels, mount, delay and drift from windows of motion, with honest covariance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.optimize import nnls

from mfslam import se2
from mfslam.calibration.record import Record, Windows, without
from mfslam.calibration.wheel_track import WheelLaw, WheelTrack
from mfslam.types import FloatArray, IntArray

MOUNT = ("mount_x_m", "mount_y_m", "mount_yaw_rad")
CLOCK = ("delay_s", "clock_drift")
CLOCK_PRIOR = np.array([0.5, 1e-3])
MOUNT_PRIOR = np.array([1.0, 1.0, 1.0])
KERNEL_SIGMAS = 3.0
ITERATIONS = 12
SMALL, SHIFT_S = 1e-6, 0.05
LAGS = (1, 2, 4, 8)  # windows joined, over which the noise is counted
BLOCKS = 40  # of the log, whose scores show how far the model of the noise can be believed


@dataclass(frozen=True, eq=False)
class Noise:
    """``ends`` (3,): variances of each end of a window, in the laser's frame there; ``per_m``, ``per_rad`` (3,): of what
    the wheels add on the way."""

    ends: FloatArray
    per_m: FloatArray
    per_rad: FloatArray


@dataclass(frozen=True, eq=False)
class Solved:
    """``values`` (P,) of ``names``, as differences from what was assumed but for wheels; ``covariance`` (P, P);
    ``weights`` (N,): of the windows; ``noise``."""

    names: tuple[str, ...]
    values: FloatArray
    covariance: FloatArray
    weights: FloatArray
    windows: Windows
    noise: Noise


class Problem:
    """Windows of the laser against the wheels' track: e = log(a_T_b^-1 mount^-1 W(t_a, t_b) mount)."""

    def __init__(
        self, record: Record, windows: Windows, law: WheelLaw, clock: bool = True, delay_s: float = 0.0
    ) -> None:
        self.record, self.law = record, law
        self.track = WheelTrack(record.knots_s, record.told_steps, law)
        reach_s = 0.1 if clock else 0.0
        ta, tb = record.times_s[windows.a] + delay_s, record.times_s[windows.b] + delay_s
        self.windows = without(windows, ~self.track.unbroken(ta - reach_s, tb + reach_s))
        self.clock = clock
        self.names = (*law.names, *MOUNT, *(CLOCK if clock else ()))
        self.start = np.concatenate([law.start, record.laser.body_T_laser, np.zeros(2 if clock else 0)])
        self.prior_sigmas = np.concatenate(
            [law.prior_sigmas, MOUNT_PRIOR, CLOCK_PRIOR if clock else np.zeros(0)]
        )
        self.middle_s = 0.5 * float(record.times_s[0] + record.times_s[-1])
        self.n_wheel = len(law.names)

    def times(self, values: FloatArray, index: IntArray) -> FloatArray:
        times = self.record.times_s[index]
        if not self.clock:
            return np.asarray(times)
        delay, drift = values[-2:]
        return np.asarray(times + delay - drift * (times - self.middle_s))

    def body_motion(self, values: FloatArray, a: IntArray, b: IntArray) -> FloatArray:
        return se2.between(self.track.at(self.times(values, a)), self.track.at(self.times(values, b)))

    def error(self, values: FloatArray, body: FloatArray, a_T_b: FloatArray) -> FloatArray:
        mount = values[self.n_wheel : self.n_wheel + 3]
        predicted = se2.compose(se2.compose(se2.inverse(mount), body), mount)
        return se2.log(se2.between(a_T_b, predicted))

    def errors(self, values: FloatArray, a: IntArray, b: IntArray, a_T_b: FloatArray) -> FloatArray:
        self.track.move(values[: self.n_wheel])
        return self.error(values, self.body_motion(values, a, b), a_T_b)

    def linearised(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Errors (N, 3) and their derivatives (N, 3, P)."""
        w = self.windows
        out = np.empty((len(w), 3, len(values)))
        self.track.move(values[: self.n_wheel])
        body = self.body_motion(values, w.a, w.b)
        error = self.error(values, body, w.a_T_b)
        for p in range(self.n_wheel, self.n_wheel + 3):
            step = values.copy()
            step[p] += SMALL
            out[:, :, p] = (self.error(step, body, w.a_T_b) - error) / SMALL
        if self.clock:
            # over a while: a step of one tick is noise, and the error at that end of the window holds the same noise
            shifted = []
            for sign in (1.0, -1.0):
                step = values.copy()
                step[-2] += sign * SHIFT_S
                shifted.append((self.body_motion(step, w.a, w.b), sign))
            ends = [self.error(values, moved, w.a_T_b) for moved, _ in shifted]
            out[:, :, -2] = (ends[0] - ends[1]) / (2.0 * SHIFT_S)
            since_s = 0.5 * (self.record.times_s[w.a] + self.record.times_s[w.b]) - self.middle_s
            out[:, :, -1] = -since_s[:, None] * out[:, :, -2]
        for p in range(self.n_wheel):
            step = values.copy()
            step[p] += SMALL
            out[:, :, p] = (self.errors(step, w.a, w.b, w.a_T_b) - error) / SMALL
        return error, out

    def amounts(self) -> tuple[FloatArray, FloatArray]:
        """Way (N,) m and turn (N,) rad of every window."""
        motion = self.windows.a_T_b
        return np.hypot(motion[:, 0], motion[:, 1]), np.abs(motion[:, 2])


def banded(
    windows: Windows, noise: Noise, weights: FloatArray, way: FloatArray, turn: FloatArray
) -> FloatArray:
    """(6, 3N) covariance of all errors, lower banded: neighbours share the error of the scan between them."""
    n = len(windows)
    ends = np.diag(noise.ends)
    back = se2.adjoint(se2.inverse(windows.a_T_b))
    own = back @ ends @ np.swapaxes(back, 1, 2) + ends
    walk = way[:, None] * noise.per_m + turn[:, None] * noise.per_rad
    own[:, range(3), range(3)] += walk
    inflated = (1.0 / weights - 1.0)[:, None] * own[:, range(3), range(3)]
    own[:, range(3), range(3)] += inflated
    later = -back[1:] @ ends  # of window k + 1 (rows) with window k (columns)
    later *= windows.goes_on[1:, None, None]
    out = np.zeros((6, 3 * n))
    for r in range(3):
        for c in range(3):
            if r >= c:
                out[r - c, c::3] = own[:, r, c]
            out[3 + r - c, c : 3 * (n - 1) : 3] = later[:, r, c]
    return out


def solve(problem: Problem, start: FloatArray | None = None, noise: Noise | None = None) -> Solved:
    values = (problem.start if start is None else start).copy()
    way, turn = problem.amounts()
    n = len(problem.windows)
    noise = noise or Noise(np.array([0.01, 0.01, 0.005]) ** 2, np.full(3, 0.02**2), np.full(3, 0.02**2))
    prior = np.diag(problem.prior_sigmas**-2.0)
    weights = np.ones(n)
    for iteration in range(ITERATIONS):
        error, jacobian = problem.linearised(values)
        weights = robust_weights(problem.windows, error, noise, way, turn)
        band = cholesky_banded(banded(problem.windows, noise, weights, way, turn), lower=True)
        flat = jacobian.reshape(3 * n, -1)
        white = cho_solve_banded((band, True), np.column_stack([flat, error.ravel()]))
        hessian = flat.T @ white[:, :-1] + prior
        gradient = flat.T @ white[:, -1] + prior @ (values - problem.start)
        step = -np.linalg.solve(hessian, gradient)
        values = values + step
        sigma = np.sqrt(np.diag(np.linalg.inv(hessian)))
        noise = found_noise(problem, values, noise)
        if iteration > 2 and np.all(np.abs(step) < 0.02 * sigma):
            break
    covariance = np.linalg.inv(hessian)
    covariance = honest(covariance, flat, white, problem.windows, n)
    return Solved(problem.names, values, covariance, weights, problem.windows, noise)


def robust_weights(
    windows: Windows, error: FloatArray, noise: Noise, way: FloatArray, turn: FloatArray
) -> FloatArray:
    variances = 2.0 * noise.ends + way[:, None] * noise.per_m + turn[:, None] * noise.per_rad
    chi2 = np.sum(error**2 / variances, axis=1) / 3.0
    return np.asarray(1.0 / (1.0 + np.maximum(0.0, chi2 / KERNEL_SIGMAS**2 - 1.0)))


def found_noise(problem: Problem, values: FloatArray, before: Noise) -> Noise:
    """From errors over 1, 2, 4, 8 windows: what does not grow is of the ends, what does of the way."""
    windows = problem.windows
    way, turn = problem.amounts()
    cum_way, cum_turn = np.concatenate([[0.0], np.cumsum(way)]), np.concatenate([[0.0], np.cumsum(turn)])
    rows, squares = [], []
    for lag in LAGS:
        first, last = windows.joined(lag)
        if len(first) < 20:
            continue
        a, b = windows.a[first], windows.b[last]
        laser = problem.record.world_T_laser
        e = problem.errors(values, a, b, se2.between(laser[a], laser[b]))
        d, t = cum_way[last + 1] - cum_way[first], cum_turn[last + 1] - cum_turn[first]
        rows.append(np.stack([np.full(len(d), 2.0), d, t], axis=1))
        squares.append(e**2)
    regressors, squared = np.concatenate(rows), np.concatenate(squares)
    out = np.empty((3, 3))
    for c in range(3):
        guess = regressors @ np.array([before.ends[c], before.per_m[c], before.per_rad[c]])
        capped = np.minimum(squared[:, c], 9.0 * guess)
        scale = 1.0 / guess
        out[c], _ = nnls(regressors * scale[:, None], capped * scale)
    floor = np.array([1e-3, 1e-3, 3e-4]) ** 2
    return Noise(np.maximum(out[:, 0], floor), np.maximum(out[:, 1], 1e-8), np.maximum(out[:, 2], 1e-8))


def honest(
    covariance: FloatArray, flat: FloatArray, white: FloatArray, windows: Windows, n: int
) -> FloatArray:
    """The covariance, widened where scores of stretches of the log scatter more than the model says."""
    scores = np.einsum("nrp,nr->np", flat.reshape(n, 3, -1), white[:, -1].reshape(n, 3))
    edges = np.unique(np.linspace(0, n, BLOCKS + 1).astype(int))
    blocks = np.add.reduceat(scores, edges[:-1], axis=0)
    meat = blocks.T @ blocks * len(blocks) / max(1, len(blocks) - 1)
    sandwich = covariance @ meat @ covariance
    widening = np.sqrt(np.maximum(1.0, np.diag(sandwich) / np.diag(covariance)))
    return np.asarray(covariance * np.outer(widening, widening))
