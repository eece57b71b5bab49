"""Systematic errors of the wheels, learned while driving, and how large the rest of their errors is.

Wheels err mostly in the same way all the time: a radius that is not quite known, a track that is wider in
turns. The twist of a true step is

    x' = (1 + scale) x,        y' = (1 + scale) y,        theta' = (1 + turn_scale) theta + drift x

of the twist (x, y in m, theta in rad) that the wheels tell: the radii and the track of a differential drive
(eqs. 8-11) have to first order just these three errors. Steps that scans matched tell the three, by recursive least
squares with the sigmas of `OdometryConfig` as prior: nothing is learned that was not thought possible.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from mfslam.config import OdometryConfig
from mfslam.kernels import wheel_steps
from mfslam.odometry import step_sigmas
from mfslam.types import FloatArray

# One measurement is made over so much driving, so that errors of the matches at its ends matter little.
WINDOW_M, WINDOW_RAD = 1.0, 0.5
MEMORY_M = 200.0  # what was learned fades over this distance: floors and loads change
SURE_SIGMA_M = 0.1  # along the motion: a match less sure than this has held on to the wheels
PRIOR_WINDOWS = 5.0  # measurements that the configured noise counts as
CONTRADICTION_SIGMAS = 3.0  # a step farther off the scans than this has slipped
DISTRUSTED_SHARE = 1e-4  # of the information of a step of wheels that jumped


def true_twists(told: FloatArray, errors: FloatArray) -> FloatArray:
    """(N, 3) twists of true steps, of those told by wheels with systematic ``errors`` (N, 3) or (3,), as in
    `WheelErrors.errors`."""
    return np.asarray(wheel_steps.true_twists(told, _of_each(errors, told)))


def told_twists(true: FloatArray, errors: FloatArray) -> FloatArray:
    """(N, 3) the inverse of `true_twists`."""
    return np.asarray(wheel_steps.told_twists(true, _of_each(errors, true)))


def as_told(true: FloatArray, errors: FloatArray) -> FloatArray:
    """(N, 3) what wheels with systematic ``errors`` (N, 3) tell of true steps (N, 3): the inverse of
    `WheelErrors.corrected`."""
    return np.asarray(wheel_steps.told_steps(true, _of_each(errors, true)))


def _of_each(errors: FloatArray, steps: FloatArray) -> FloatArray:
    return errors if errors.ndim == 2 else np.tile(errors, (len(steps), 1))


@dataclass(frozen=True, eq=False, slots=True)
class WheelStep:
    """Motion from one keyframe to the next: as ``told`` by the wheels and as ``matched`` by the scans (3,),
    the match's ``information`` (3, 3), and whether the wheels were found to have ``jumped``."""

    told: FloatArray
    matched: FloatArray
    information: FloatArray
    jumped: bool = False


@dataclass(eq=False, slots=True)
class _Window:
    """Sums over the steps of one measurement."""

    told: FloatArray = field(default_factory=lambda: np.zeros(3))
    matched: FloatArray = field(default_factory=lambda: np.zeros(3))
    corrected: FloatArray = field(default_factory=lambda: np.zeros(3))
    wheel_variances: FloatArray = field(default_factory=lambda: np.zeros(3))
    match_variances: FloatArray = field(default_factory=lambda: np.zeros(3))  # the largest
    travelled_m: float = 0.0
    turned_rad: float = 0.0


class WheelErrors:
    """``errors`` (3,): scale (m per m), turn scale (rad per rad) and drift (rad per m), as learned so far, and
    ``noise_share`` (3,): variance of what remains, over the configured one, along x, y, theta; ``noise_scale`` (3,): how many
    times noisier than configured the wheels turned out to be, 1 where they are no worse."""

    def __init__(self, config: OdometryConfig) -> None:
        self.errors = np.zeros(3)  # scale, turn_scale, drift_rad_per_m
        self._believe(np.ones(3))
        self._config, self._step_noise = config, config.step_noise
        self._turn_prior = np.diag([config.sigma_rotation_per_m**-2, config.sigma_rotation_per_rad**-2])
        self._scale_prior = config.sigma_translation_per_m**-2
        self._turn_information, self._turn_vector = np.zeros((2, 2)), np.zeros(2)
        self._scale_information = self._scale_vector = 0.0
        self._windows, self._chi2 = np.zeros(3), np.zeros(3)
        self._window = _Window()

    def found(self, errors: FloatArray, noise_share: FloatArray) -> None:
        """What the adjustment of the whole log made of them."""
        self.errors = errors.copy()
        self._believe(noise_share)

    def _believe(self, noise_share: FloatArray) -> None:
        self.noise_share = noise_share
        self.noise_scale = np.sqrt(np.maximum(1.0, noise_share))

    def as_json(self) -> dict[str, object]:
        """What was learned, in the units of a report."""
        scale, turn_scale, drift_rad_per_m = self.errors.tolist()
        return {
            "scale_error_percent": 100.0 * scale,
            "drift_deg_per_m": math.degrees(drift_rad_per_m),
            "turn_error_percent": 100.0 * turn_scale,
            "noise_share": self.noise_share.tolist(),
        }

    def corrected(self, step: FloatArray) -> FloatArray:
        """A step (3,) as told by the wheels, without the errors learned so far."""
        return np.asarray(wheel_steps.true_step(step, self.errors))

    def advanced(self, odom_T_body: FloatArray, step: FloatArray) -> FloatArray:
        """Where a step (3,) that the wheels told leads, from ``odom_T_body`` (3,), without the errors learned so far."""
        return np.asarray(wheel_steps.advance_by_told(odom_T_body, step, self.errors))

    def told(self, corrected: FloatArray) -> FloatArray:
        """The inverse of `corrected`: what the wheels told."""
        (step,) = as_told(corrected[None], self.errors)
        return np.asarray(step)

    def factors(self, steps: Sequence[WheelStep]) -> tuple[FloatArray, FloatArray]:
        """The corrected steps (N, 3) as factors and their information (N, 3, 3): by the noise that was learned, next to none
        of wheels that jumped, and less where a step contradicts the scans."""
        told, matched = np.array([s.told for s in steps]), np.array([s.matched for s in steps])
        known = np.array([s.information for s in steps])
        jumped = np.array([s.jumped for s in steps])
        shares = (
            self.noise_share
            / self._config.white_share
            * np.where(jumped, 1.0 / DISTRUSTED_SHARE, 1.0)[:, None]
        )
        corrected, information = wheel_steps.weigh_steps(
            told,
            matched,
            _variances(known),
            shares,
            self.errors,
            self._step_noise,
            CONTRADICTION_SIGMAS,
        )
        return corrected, information

    def skip(self) -> None:
        """The chain of steps is broken: the next one begins a new measurement."""
        self._window = _Window()

    def learn(self, step: WheelStep) -> None:
        """Take in the next step whose match was good."""
        if not self._config.learn_errors:
            return
        window, corrected = self._window, self.corrected(step.told)
        window.told += step.told
        window.matched += step.matched
        window.corrected += corrected
        window.wheel_variances += step_sigmas(corrected, self._step_noise) ** 2
        # errors of the matches within the window cancel: those at its two ends remain
        window.match_variances = np.maximum(window.match_variances, 2.0 * _variances(step.information))
        window.travelled_m += abs(float(step.told[0]))
        window.turned_rad += abs(float(step.told[2]))
        if window.travelled_m >= WINDOW_M or window.turned_rad >= WINDOW_RAD:
            fade = math.exp(-window.travelled_m / MEMORY_M)
            self._learn_noise(window, fade)
            self._learn_turn(window, fade)
            self._learn_scale(window, fade)
            self._window = _Window()

    def _learn_turn(self, window: _Window, fade: float) -> None:
        row = np.array([window.told[0], window.told[2]])
        noise = window.match_variances[2] + self._config.sigma_floor_rad**2
        self._turn_information = fade * self._turn_information + np.outer(row, row) / noise
        self._turn_vector = fade * self._turn_vector + row * (window.matched[2] - window.told[2]) / noise
        drift, turn_scale = np.linalg.solve(self._turn_information + self._turn_prior, self._turn_vector)
        self.errors[1], self.errors[2] = turn_scale, drift

    def _learn_scale(self, window: _Window, fade: float) -> None:
        self._scale_information *= fade
        self._scale_vector *= fade
        if window.match_variances[0] < 2.0 * SURE_SIGMA_M**2:
            x, noise = float(window.told[0]), float(window.match_variances[0]) + self._config.sigma_floor_m**2
            self._scale_information += x * x / noise
            self._scale_vector += x * (float(window.matched[0]) - x) / noise
        self.errors[0] = self._scale_vector / (self._scale_information + self._scale_prior)

    def _learn_noise(self, window: _Window, fade: float) -> None:
        # only matches surer than the wheels tell how good the wheels are
        sure = window.match_variances < window.wheel_variances
        off = (window.matched - window.corrected) ** 2
        self._windows = fade * self._windows + sure
        self._chi2 = fade * self._chi2 + np.where(sure, off / window.wheel_variances, 0.0)
        self._believe((PRIOR_WINDOWS + self._chi2) / (PRIOR_WINDOWS + self._windows))


def _variances(information: FloatArray) -> FloatArray:
    """Variances (..., 3) of each direction, the others being known, by ``information`` (..., 3, 3)."""
    return np.asarray(1.0 / np.maximum(np.diagonal(information, axis1=-2, axis2=-1), 1e-9))
