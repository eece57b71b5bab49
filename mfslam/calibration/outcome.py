"""What a calibration comes to: values with sigmas, what could not be seen and what would show it, settings."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from mfslam.calibration.gyro import GyroFit
from mfslam.calibration.laser_turn import LaserTurn
from mfslam.calibration.range_errors import RangeErrors
from mfslam.calibration.record import Record
from mfslam.calibration.settings import Settings, settings_of
from mfslam.calibration.solve import Solved
from mfslam.calibration.start import Start
from mfslam.config import Config
from mfslam.types import FloatArray

SIGNIFICANT_SIGMAS = 4.0
PULL = 0.2  # of a change, by which the laser's motions may still hold on to what was assumed for them


@dataclass(frozen=True)
class Kind:
    """Of one parameter: its unit, the sigma beyond which it is not observable, the change that matters in practice,
    and the manoeuvre that shows it."""

    unit: str
    most_sigma: float
    matters: float
    manoeuvre: str


IN_PLACE = "turn in place both ways, a full turn at least"
AHEAD = "drive straight ahead for 5 m or more"
STOP_AND_GO = "start and stop turning briskly, ten times or more"
KINDS = {
    "radius_left": Kind("m", 0.02, 0.005, AHEAD),
    "radius_right": Kind("m", 0.02, 0.005, AHEAD),
    "track": Kind("m", 0.05, 0.01, IN_PLACE),
    "scale": Kind("", 0.02, 0.005, AHEAD),
    "turn_scale": Kind("", 0.05, 0.01, IN_PLACE),
    "drift": Kind("rad/m", 0.01, 0.002, AHEAD),
    "mount_x": Kind("m", 0.02, 0.01, IN_PLACE),
    "mount_y": Kind("m", 0.02, 0.01, IN_PLACE + ", and " + AHEAD),
    "mount_yaw": Kind("deg", 1.0, 0.5, AHEAD),
    "delay": Kind("s", 0.02, 0.008, STOP_AND_GO),
    "clock_drift": Kind("s/s", 1e-4, 2e-5, STOP_AND_GO + ", at the beginning and at the end of a long log"),
    "turn_period": Kind(
        "s", 0.02, 0.015, "turn in place both ways, and stand or drive straight at the same places"
    ),
    "gyro_scale": Kind("", 0.02, 0.005, IN_PLACE),
    "gyro_bias": Kind("rad/s", 0.002, 0.001, "stand still for 10 s or more"),
}
GEOMETRY = (
    "mount_x",
    "mount_y",
    "mount_yaw",
    "delay",
    "clock_drift",
    "turn_period",
)  # what wheels that learn by themselves cannot make good


@dataclass(frozen=True)
class Estimate:
    """One parameter: as it was assumed (``before``), as found, its sigma, all in the unit of its `Kind`; ``pulled``: how
    far of that it may have been pulled to what was assumed in this pass."""

    name: str
    before: float
    value: float
    sigma: float
    relative_to: float = 1.0  # sigmas and changes are judged as shares of this
    pulled: float = 0.0

    @property
    def kind(self) -> Kind:
        return KINDS[self.name]

    @property
    def unpulled_sigma(self) -> float:
        """By what the log tells: nothing pulls at a value that is as assumed, and the next pass frees the others."""
        return math.sqrt(max(0.0, self.sigma**2 - self.pulled**2))

    @property
    def observable(self) -> bool:
        return self.unpulled_sigma < self.kind.most_sigma * self.relative_to

    @property
    def significant(self) -> bool:
        """Whether it differs from what was assumed, surely and by so much that it matters."""
        change = abs(self.value - self.before)
        return (
            self.observable
            and change > SIGNIFICANT_SIGMAS * self.unpulled_sigma
            and change > self.kind.matters * self.relative_to
        )

    def line(self) -> str:
        name = self.name.replace("_", " ")
        if not self.observable:
            return f"{name:14s} not observable in this log: {self.kind.manoeuvre}"
        unit = f" {self.kind.unit}" if self.kind.unit else ""
        return f"{name:14s} {self.value:10.5f} +- {self.sigma:.5f}{unit}   (assumed {self.before:.5f})"

    def as_json(self) -> dict[str, Any]:
        return {
            "assumed": self.before,
            "found": self.value if self.observable else None,
            "sigma": self.sigma,
            "unit": self.kind.unit,
            "observable": self.observable,
            "significant": self.significant,
        } | ({} if self.observable else {"would_show_it": self.kind.manoeuvre})


@dataclass(frozen=True, eq=False)
class Calibration:
    """``estimates`` in the order of ``covariance`` (P, P), which is in their units; ``start``: what was found of signs;
    ``middle_s``: of the log, from its start, for which the delay holds where clocks drift; ``range_errors``: None where too
    little is told of them."""

    estimates: list[Estimate]
    covariance: FloatArray
    start: Start
    config: Config
    middle_s: float = 0.0
    range_errors: RangeErrors | None = None

    def __getitem__(self, name: str) -> Estimate:
        return next(e for e in self.estimates if e.name == name)

    @property
    def significant(self) -> list[Estimate]:
        return [e for e in self.estimates if e.significant]

    @property
    def changes(self) -> bool:
        """Whether anything is surely other than was assumed."""
        ranges = self.range_errors
        return bool(self.significant or self.oddities or (ranges is not None and ranges.significant))

    def since(self, first: Calibration) -> Calibration:
        """The same, seen from what the first pass assumed, and what that found of the wheels' signs."""
        estimates = [
            replace(e, before=was.before) for e, was in zip(self.estimates, first.estimates, strict=True)
        ]
        ranges = self.range_errors and self.range_errors.since(first.config.sensor)
        return replace(self, estimates=estimates, start=first.start, config=first.config, range_errors=ranges)

    def extended(self, more: tuple[list[Estimate], FloatArray]) -> Calibration:
        """With further estimates and their covariance, independent of these."""
        estimates, covariance = more
        both = block_diag(self.covariance, covariance) if estimates else self.covariance
        return replace(self, estimates=self.estimates + estimates, covariance=both)

    @property
    def oddities(self) -> str:
        """What is wired or turns otherwise than assumed; empty where nothing does."""
        turns = next((e for e in self.estimates if e.name == "turn_period" and e.significant), None)
        words = [self.start.words]
        if turns is not None and turns.value < 0.0 <= turns.before:
            words.append("the laser turns against the order of its beams")
        if turns is not None and turns.before < 0.0 < turns.value:
            words.append("the laser turns in the order of its beams")
        return " and ".join(word for word in words if word)

    def what_changes(self) -> str:
        """In words what is worth mapping again for; empty where nothing is."""
        wrong = [self.oddities] if self.oddities else []
        changed = [e for e in self.significant if e.name in GEOMETRY]
        words = [f"{e.name} {e.before:.4g} -> {e.value:.4g} {e.kind.unit}" for e in changed]
        ranges = self.range_errors
        if ranges is not None and ranges.significant:
            words.append(f"ranges too large by {ranges.words}")
        return ", ".join(wrong + words)

    def settings(self) -> Settings:
        """Stage, key and value of all that is observable and that a setting exists for."""
        return settings_of(self)

    def lines(self) -> Iterator[str]:
        if self.oddities:
            yield f"WARNING        {self.oddities}"
        for e in self.estimates:
            yield e.line()
        if self.range_errors is not None:
            yield self.range_errors.line()

    def as_json(self) -> dict[str, Any]:
        odd = {"oddities": self.oddities} if self.oddities else {}
        ranges = {} if self.range_errors is None else {"range_errors": self.range_errors.as_json()}
        return odd | {e.name: e.as_json() for e in self.estimates} | ranges


def calibration_of(solved: Solved, record: Record, start: Start, config: Config) -> Calibration:
    """Values in the units of people, from the solver's."""
    wheels = config.wheels
    nominal = {
        "radius_left": wheels.radius_left_m, "radius_right": wheels.radius_right_m, "track": wheels.track_m,
        "mount_yaw_rad": math.degrees(1.0),
    }  # fmt: skip
    mount = record.laser.body_T_laser
    before = {
        "radius_left": 1.0, "radius_right": 1.0, "track": 1.0, "scale": 1.0, "turn_scale": 1.0, "drift": 0.0,
        "mount_x_m": mount[0], "mount_y_m": mount[1], "mount_yaw_rad": mount[2], "delay_s": 0.0, "clock_drift": 0.0,
    }  # fmt: skip
    middle_s = 0.5 * float(record.times_s[0] + record.times_s[-1])
    drift = config.sensor.clock_drift
    known = {"delay_s": config.sensor.transport_delay_s - drift * middle_s, "clock_drift": drift}
    relative = {
        "radius_left": wheels.radius_left_m,
        "radius_right": wheels.radius_right_m,
        "track": wheels.track_m,
    }
    factors = np.array([nominal.get(name, 1.0) for name in solved.names])
    covariance = solved.covariance * np.outer(factors, factors)
    estimates = []
    for n, name in enumerate(solved.names):
        offset = known.get(name, 0.0)
        short = name.removesuffix("_m").removesuffix("_s").removesuffix("_rad")
        assumed, value = (float(v * factors[n] + offset) for v in (before[name], solved.values[n]))
        pulled = PULL * abs(value - assumed)
        covariance[n, n] += pulled**2
        sigma = math.sqrt(covariance[n, n])
        estimates.append(Estimate(short, assumed, value, sigma, relative.get(name, 1.0), pulled))
    return Calibration(estimates, covariance, start, config, middle_s)


def gyro_estimates(fit: GyroFit | None, config: Config) -> tuple[list[Estimate], FloatArray]:
    """Of the gyro, what it tells after what was assumed of it."""
    if fit is None:
        return [], np.zeros((0, 0))
    scale, bias = config.imu.gyro_scale, config.imu.gyro_bias_rad_s
    sigmas = scale * np.sqrt(np.diag(fit.covariance))
    return [
        Estimate("gyro_scale", scale, scale * fit.scale, float(sigmas[0])),
        Estimate("gyro_bias", bias, bias + scale * fit.bias_rad_s, float(sigmas[1])),
    ], scale**2 * fit.covariance


def turn_estimates(turn: LaserTurn | None, config: Config) -> tuple[list[Estimate], FloatArray]:
    """Of the laser's turn, negative against the order of its beams; a robot that hardly turned does not show it."""
    sign = -1.0 if config.sensor.reversed_beams else 1.0
    assumed, found, sigma = (0.0, 0.0, 1.0) if turn is None else (turn.assumed_s, turn.period_s, turn.sigma_s)
    assumed, found = sign * assumed, sign * found
    return [Estimate("turn_period", assumed, found, sigma)], np.array([[sigma**2]])
