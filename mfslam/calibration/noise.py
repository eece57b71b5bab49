"""Errors of windows: of the poses at their ends, which neighbours share, and of what the wheels add on the way."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import nnls

from mfslam import se2
from mfslam.calibration.record import Windows
from mfslam.types import FloatArray

if TYPE_CHECKING:
    from mfslam.calibration.problem import Problem

KERNEL_SIGMAS = 3.0
LAGS = (1, 2, 4, 8)  # windows joined, over which the noise is counted
FLOOR = np.array([1e-3, 1e-3, 3e-4]) ** 2
LEAST_WALK = 1e-8


@dataclass(frozen=True, eq=False)
class Noise:
    """``ends`` (3,): variances of each end of a window, in the laser's frame there; ``per_m``, ``per_rad`` (3,): of what
    the wheels add on the way."""

    ends: FloatArray
    per_m: FloatArray
    per_rad: FloatArray

    def variances(self, way_m: FloatArray, turn_rad: FloatArray) -> FloatArray:
        """(N, 3) of windows over such ways and turns (N,)."""
        walk = way_m[:, None] * self.per_m + turn_rad[:, None] * self.per_rad
        return np.asarray(2.0 * self.ends + walk)


FIRST_GUESS = Noise(np.array([0.01, 0.01, 0.005]) ** 2, np.full(3, 0.02**2), np.full(3, 0.02**2))


def banded(windows: Windows, noise: Noise, weights: FloatArray) -> FloatArray:
    """(6, 3N) covariance of all errors, lower banded: neighbours share the error of the scan between them."""
    n = len(windows)
    ends = np.diag(noise.ends)
    back = se2.adjoint(se2.inverse(windows.a_T_b))
    own = back @ ends @ np.swapaxes(back, 1, 2) + ends
    way_m, turn_rad = windows.amounts()
    own[:, range(3), range(3)] += noise.variances(way_m, turn_rad) - 2.0 * noise.ends
    own[:, range(3), range(3)] /= weights[:, None]
    later = -back[1:] @ ends  # of window k + 1 (rows) with window k (columns)
    later *= windows.goes_on[1:, None, None]
    out = np.zeros((6, 3 * n))
    for r in range(3):
        for c in range(3):
            if r >= c:
                out[r - c, c::3] = own[:, r, c]
            out[3 + r - c, c : 3 * (n - 1) : 3] = later[:, r, c]
    return out


def robust_weights(windows: Windows, error: FloatArray, noise: Noise) -> FloatArray:
    """(N,) by Cauchy's law, beyond `KERNEL_SIGMAS`."""
    chi2 = np.sum(error**2 / noise.variances(*windows.amounts()), axis=1) / 3.0
    return np.asarray(1.0 / (1.0 + np.maximum(0.0, chi2 / KERNEL_SIGMAS**2 - 1.0)))


def found_noise(problem: Problem, values: FloatArray, before: Noise) -> Noise:
    """From errors over 1, 2, 4, 8 windows: what does not grow is of the ends, what does of the way."""
    windows = problem.windows
    way_m, turn_rad = (np.concatenate([[0.0], np.cumsum(amount)]) for amount in windows.amounts())
    rows, squares = [], []
    for lag in LAGS:
        first, last = windows.joined(lag)
        if len(first) < 20:
            continue
        a, b = windows.a[first], windows.b[last]
        laser = problem.record.world_T_laser
        error = problem.errors(values, a, b, se2.between(laser[a], laser[b]))
        far, turned = way_m[last + 1] - way_m[first], turn_rad[last + 1] - turn_rad[first]
        rows.append(np.stack([np.full(len(far), 2.0), far, turned], axis=1))
        squares.append(error**2)
    regressors, squared = np.concatenate(rows), np.concatenate(squares)
    out = np.empty((3, 3))
    for c in range(3):
        guess = regressors @ np.array([before.ends[c], before.per_m[c], before.per_rad[c]])
        capped = np.minimum(squared[:, c], 9.0 * guess)
        out[c], _ = nnls(regressors / guess[:, None], capped / guess)
    return Noise(
        np.maximum(out[:, 0], FLOOR), np.maximum(out[:, 1], LEAST_WALK), np.maximum(out[:, 2], LEAST_WALK)
    )
