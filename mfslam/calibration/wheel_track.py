"""The wheels' track under other geometries: told steps -> true steps by the parameters -> poses at any instant."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from mfslam import se2, wheel_errors
from mfslam.types import BoolArray, FloatArray, IntArray


class WheelLaw(Protocol):
    """How told twists become true ones under ``values`` (W,), which are ``names`` in this order."""

    @property
    def names(self) -> tuple[str, ...]: ...

    @property
    def start(self) -> FloatArray: ...

    @property
    def prior_sigmas(self) -> FloatArray: ...

    def true_twists(self, told: FloatArray, values: FloatArray) -> FloatArray:
        """(K, 3)"""
        ...

    def told_twists(self, true: FloatArray, values: FloatArray) -> FloatArray:
        """(K, 3) the inverse of `true_twists`."""
        ...


@dataclass(frozen=True, eq=False)
class DifferentialDrive:
    """Eqs. 8-11 with unknown geometry: the told twist gives back what each wheel rolled by the nominal geometry,
    a_L = x - L theta / 2, a_R = x + L theta / 2; with radii rho_L, rho_R and a track beta times the nominal ones
    x' = (rho_L a_L + rho_R a_R) / 2, theta' = (rho_R a_R - rho_L a_L) / (beta L).

    ``signs`` (2, 2): what left and right wheel really are of the two that are told: swapped, or counted backwards.
    """

    track_m: float
    signs: FloatArray
    names: tuple[str, ...] = ("radius_left", "radius_right", "track")
    start: FloatArray = field(default_factory=lambda: np.ones(3))
    prior_sigmas: FloatArray = field(default_factory=lambda: np.array([0.3, 0.3, 0.5]))

    def true_twists(self, told: FloatArray, values: FloatArray) -> FloatArray:
        half = 0.5 * self.track_m * told[:, 2]
        rolled = np.stack([told[:, 0] - half, told[:, 0] + half], axis=1) @ self.signs.T
        left, right = values[0] * rolled[:, 0], values[1] * rolled[:, 1]
        return np.stack(
            [0.5 * (left + right), told[:, 1], (right - left) / (values[2] * self.track_m)], axis=1
        )

    def told_twists(self, true: FloatArray, values: FloatArray) -> FloatArray:
        half = 0.5 * values[2] * self.track_m * true[:, 2]
        rolled = np.stack([(true[:, 0] - half) / values[0], (true[:, 0] + half) / values[1]], axis=1)
        left, right = (rolled @ np.linalg.inv(self.signs.T)).T
        return np.stack([0.5 * (left + right), true[:, 1], (right - left) / self.track_m], axis=1)


@dataclass(frozen=True, eq=False)
class PoseOdometry:
    """Poses of unknown wheels: the law of `mfslam.wheel_errors`, with 1 + scale and 1 + turn_scale as values."""

    names: tuple[str, ...] = ("scale", "turn_scale", "drift")
    start: FloatArray = field(default_factory=lambda: np.array([1.0, 1.0, 0.0]))
    prior_sigmas: FloatArray = field(default_factory=lambda: np.array([0.3, 0.5, 0.3]))

    def true_twists(self, told: FloatArray, values: FloatArray) -> FloatArray:
        return wheel_errors.true_twists(told, values - self.start)

    def told_twists(self, true: FloatArray, values: FloatArray) -> FloatArray:
        return wheel_errors.told_twists(true, values - self.start)


class WheelTrack:
    """Poses of a law's steps at any instant: constant twist from knot to knot (eq. 16)."""

    def __init__(self, knots_s: FloatArray, told_steps: FloatArray, law: WheelLaw) -> None:
        known = np.isfinite(told_steps[:, 0])
        steps = np.where(known[:, None], told_steps, 0.0)
        self._knots_s = knots_s
        self._law = law
        self._told = se2.log(steps)
        self._breaks = np.cumsum(~known)
        self.move(law.start)

    def move(self, values: FloatArray) -> None:
        """The track by other values of the law."""
        self._twists = self._law.true_twists(self._told, values)
        chords = se2.exp(self._twists)
        heading = np.cumsum(self._twists[:, 2])
        before = heading - self._twists[:, 2]
        c, s = np.cos(before), np.sin(before)
        x = np.cumsum(c * chords[:, 0] - s * chords[:, 1])
        y = np.cumsum(s * chords[:, 0] + c * chords[:, 1])
        self._poses = np.stack([x, y, heading], axis=1)

    def at(self, times_s: FloatArray) -> FloatArray:
        """(N, 3)"""
        after, share = self._place(times_s)
        return se2.compose(self._poses[after - 1], se2.exp(share[:, None] * self._twists[after]))

    def twist_at(self, times_s: FloatArray) -> FloatArray:
        """(N, 3) per second."""
        after, _ = self._place(times_s)
        gap_s = self._knots_s[after] - self._knots_s[after - 1]
        return np.asarray(self._twists[after] / np.maximum(gap_s, 1e-3)[:, None])

    def unbroken(self, start_s: FloatArray, end_s: FloatArray) -> BoolArray:
        """(N,) whether every step between two instants is known and within the track."""
        first, last = self._place(start_s)[0], self._place(end_s)[0]
        inside = (start_s >= self._knots_s[0]) & (end_s <= self._knots_s[-1])
        return np.asarray(inside & (self._breaks[last] == self._breaks[first - 1]))

    def _place(self, times_s: FloatArray) -> tuple[IntArray, FloatArray]:
        knots = self._knots_s
        after = np.clip(np.searchsorted(knots, times_s, side="right"), 1, len(knots) - 1)
        gap_s = knots[after] - knots[after - 1]
        share = np.clip((times_s - knots[after - 1]) / np.where(gap_s > 0.0, gap_s, 1.0), 0.0, 1.0)
        return after, share
