"""What the wheels say in the adjustment: their steps, their systematic errors as unknowns, their noise as found."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from mfslam import se2
from mfslam.adjustment.equations import Solver
from mfslam.config import OdometryConfig
from mfslam.odometry import step_sigmas
from mfslam.types import FloatArray, IntArray
from mfslam.wheel_errors import MEMORY_M, WheelStep, as_told

WINDOW_M, WINDOW_RAD = 1.0, 0.5  # of driving, over which the wheels' noise is counted: slip lasts for a while
KERNEL_SIGMAS = 3.0  # of the Cauchy kernel on wheel steps
LEAST_SHARE = 1e-3  # of the configured variance that wheels can be found to have
PROBED, PROBE_ERROR = 400, 0.1  # errors in all random probes at least
PRIOR = 0.1  # of an error that the configured noise counts as: it is meant to be too large, not too small
SMALL = 1e-6
LITTLE = 0.3  # of the errors: where the fit takes less, how much exactly matters little


class WheelTerms:
    """Wheel steps between successive keyframes.

    The unknowns of every ``MEMORY_M`` of driving are scale, turn_scale and drift_rad_per_m as in
    `WheelErrors`; ``errors`` (W, 3) holds them. ``share`` (3,): variance of what remains of x, y, theta, over
    the configured one (`step_sigmas`, by their white share).
    """

    def __init__(
        self, steps: Sequence[tuple[int, int, WheelStep]], errors: FloatArray, share: FloatArray,
        config: OdometryConfig,
    ) -> None:  # fmt: skip
        used = [(i, j, step) for i, j, step in steps if not step.jumped]
        self.i = np.array([i for i, _, _ in used], dtype=np.int64)
        self.j = np.array([j for _, j, _ in used], dtype=np.int64)
        self.told = np.array([step.told for _, _, step in used]).reshape(-1, 3)
        travelled_m = np.cumsum(np.hypot(self.told[:, 0], self.told[:, 1]))
        self.stretch = (travelled_m / MEMORY_M).astype(np.int64)
        self.errors = np.tile(errors, (1 + int(self.stretch.max(initial=-1)), 1))
        self.share = share.copy()
        self._start = errors
        sigmas = np.array([step_sigmas(told, config.step_noise) for told in self.told]).reshape(-1, 3)
        self._variances = sigmas**2 / config.white_share
        self._learn = config.learn_errors
        self._prior = np.diag(
            [
                config.sigma_translation_per_m**-2,
                config.sigma_rotation_per_rad**-2,
                config.sigma_rotation_per_m**-2,
            ]
        )

        self._taken = np.ones((2, 3))  # by the fit of the errors of steps and of windows: shares
        self._cut_windows()

    def __len__(self) -> int:
        return len(self.told)

    @property
    def mean_errors(self) -> FloatArray:
        """(3,) over the whole log."""
        return np.asarray(self.errors.mean(axis=0))

    def variances(self) -> FloatArray:
        """(N, 3) of the steps as told. Where on its way a step turned is not known: what the correction of the turn
        does sideways is so uncertain."""
        out = self.share * self._variances
        _, turn_scale, drift = self.errors[self.stretch].T
        added = turn_scale * self.told[:, 2] + drift * self.told[:, 0]
        out[:, 1] += (0.5 * self.told[:, 0] * added) ** 2
        return out

    def error(self, poses: FloatArray, errors: FloatArray) -> FloatArray:
        """(N, 3) of what was told against what wheels with ``errors`` (W, 3) tell between poses (K, 3), in the frame of the
        later one. The true steps are the ones to go from: noise in what is told would make its own errors look
        systematic."""
        moved = se2.between(poses[self.i], poses[self.j])
        return se2.log(se2.between(self.told, as_told(moved, errors[self.stretch])))

    def add_to(self, add: Callable[..., None], poses: FloatArray, first_unknown: int) -> None:
        """The terms of all steps, and of what the errors are before anything is known of them."""
        error = self.error(poses, self.errors)
        information = 1.0 / self.variances()
        weight = 1.0 / (1.0 + np.sum(error**2 * information, axis=1) / KERNEL_SIGMAS**2)
        by_error = np.stack(
            [(self.error(poses, self.errors + SMALL * unit) - error) / SMALL for unit in np.eye(3)], axis=2
        )
        before, after = between_jacobians(se2.between(poses[self.i], poses[self.j]))
        add(
            [(self.i, before), (self.j, after), (first_unknown + self.stretch, by_error)],
            error,
            weight[:, None, None] * information[:, :, None] * np.eye(3),
        )
        count = len(self.errors)
        add(
            [(first_unknown + np.arange(count), np.tile(np.eye(3), (count, 1, 1)))],
            self.errors - self._start,
            np.tile(self._prior, (count, 1, 1)),
        )

    def learn_noise(self, poses: FloatArray, solver: Solver, unknowns: int, probe: bool = True) -> None:
        """The shares that the residuals show (variance component estimation).

        Without ``probe``, what the fit takes of the errors is taken from the last time, unless it is much of them.

        By single steps, which tell most; by windows of driving where these surely show more: slip that lasts.
        """
        if not self._learn or not len(self._first):
            return
        error, variances = self.error(poses, self.errors), self.variances()
        carried = (
            (self._carry @ error[:, :, None])[:, :, 0],
            (self._carry**2 @ variances[:, :, None])[:, :, 0],
        )
        of_windows = [np.add.reduceat(terms, self._starts)[self._whole] for terms in carried]
        by_step = _Motions(poses, self.i, self.j, error, variances)
        by_window = _Motions(poses, self.i[self._first], self.j[self._last], *of_windows)
        both = (by_step, by_window)
        if probe or np.max(self._taken) > LITTLE:
            probes = [motions.probes(unknowns) for motions in both]
            ends = solver.solve(np.concatenate(probes, axis=1), PROBE_ERROR)
            ends_of = np.split(ends, [probes[0].shape[1]], axis=1)
            self._taken = np.stack([m.taken(p, e) for m, p, e in zip(both, probes, ends_of, strict=True)])
        share, _ = by_step.share(self.share, self._taken[0])
        lasting, sigma = by_window.share(self.share, self._taken[1])
        self.share = np.maximum(np.maximum(share, lasting * (1.0 - 2.0 * sigma)), LEAST_SHARE)

    def _cut_windows(self) -> None:
        """Windows of unbroken driving: first step of each (``_starts``), which of them are ``_whole``, their
        ``_first`` and ``_last`` steps, and what carries an error of each step to the end of its window."""
        starts, whole, last = [], [], []
        self._carry = np.empty((len(self), 3, 3))
        n = 0
        while n < len(self):
            starts.append(n)
            far = turned = 0.0
            while n < len(self) and (n == starts[-1] or self.i[n] == self.j[n - 1]):
                far += abs(float(self.told[n, 0]))
                turned += abs(float(self.told[n, 2]))
                n += 1
                if far >= WINDOW_M or turned >= WINDOW_RAD:
                    break
            whole.append(far >= WINDOW_M or turned >= WINDOW_RAD)
            last.append(n - 1)
            rest = np.zeros(3)
            for k in range(n - 1, starts[-1] - 1, -1):
                self._carry[k] = se2.adjoint(se2.inverse(rest))
                rest = se2.compose(self.told[k], rest)
        self._starts, self._whole = np.array(starts, dtype=np.int64), np.array(whole, dtype=np.bool_)
        self._first, self._last = self._starts[self._whole], np.array(last, dtype=np.int64)[self._whole]


@dataclass(frozen=True, eq=False)
class _Motions:
    """Errors (N, 3) of motions from keyframes ``a`` to ``b`` (N,), and the variances they were given.

    E(sum e^2 / v) is the number of errors less trace(C A), what the fit has taken of them; C the
    covariance of all unknowns, A the errors' own information, the trace by random probes.
    """

    poses: FloatArray
    a: IntArray
    b: IntArray
    error: FloatArray
    variances: FloatArray

    def probes(self, unknowns: int) -> FloatArray:
        """(3 ``unknowns``, 3 P): P of x, then of y, then of theta."""
        before, after = between_jacobians(se2.between(self.poses[self.a], self.poses[self.b]))
        count = len(self.a)
        each = math.ceil(PROBED / count)
        signs = np.random.default_rng(0).integers(0, 2, (3 * each, count)) * 2.0 - 1.0
        out = np.zeros((3 * each, unknowns, 3))
        for n, sign in enumerate(signs):
            c = n // each
            u = (sign / np.sqrt(self.variances[:, c]))[:, None]
            np.add.at(out[n], self.a, u * before[:, c])
            np.add.at(out[n], self.b, u * after[:, c])
        return np.ascontiguousarray(out.reshape(3 * each, -1).T)

    def taken(self, probes: FloatArray, solved: FloatArray) -> FloatArray:
        """(3,) trace(C A) over the number of errors; ``solved``: C times the probes."""
        return np.asarray(np.sum(probes * solved, axis=0).reshape(3, -1).mean(axis=1) / len(self.a))

    def share(self, share: FloatArray, taken: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(3,) shares of the variances, from those assumed, and their relative sigmas."""
        left = len(self.a) * np.maximum(0.0, 1.0 - taken)
        normalised = self.error**2 / self.variances
        chi2 = np.sum(normalised / (1.0 + normalised / KERNEL_SIGMAS**2), axis=0)
        return (PRIOR + share * chi2) / (PRIOR + left), np.sqrt(2.0 / (PRIOR + left))


def between_jacobians(i_T_j: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(N, 3, 3) of log(measured^-1 i_T_j) by right perturbations of pose i and of pose j, for small errors."""
    before = -se2.adjoint(se2.inverse(i_T_j))
    return before, np.tile(np.eye(3), (len(i_T_j), 1, 1))
