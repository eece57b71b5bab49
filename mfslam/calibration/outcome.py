"""What a calibration comes to: values with sigmas, what could not be seen and what would show it, settings."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mfslam.calibration.record import Record
from mfslam.calibration.solve import Solved
from mfslam.calibration.start import Start
from mfslam.config import Config
from mfslam.types import FloatArray

SIGNIFICANT_SIGMAS = 4.0


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
    "gyro_scale": Kind("", 0.02, 0.005, IN_PLACE),
    "gyro_bias": Kind("rad/s", 0.002, 0.001, "stand still for 10 s or more"),
}
GEOMETRY = (
    "mount_x",
    "mount_y",
    "mount_yaw",
    "delay",
)  # what wheels that learn by themselves cannot make good


@dataclass(frozen=True)
class Estimate:
    """One parameter: as it was assumed (``before``), as found, its sigma, all in the unit of its `Kind`."""

    name: str
    before: float
    value: float
    sigma: float
    relative_to: float = 1.0  # sigmas and changes are judged as shares of this

    @property
    def kind(self) -> Kind:
        return KINDS[self.name]

    @property
    def observable(self) -> bool:
        return self.sigma < self.kind.most_sigma * self.relative_to

    @property
    def significant(self) -> bool:
        """Whether it differs from what was assumed, surely and by so much that it matters."""
        change = abs(self.value - self.before)
        return (
            self.observable
            and change > SIGNIFICANT_SIGMAS * self.sigma
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
    """``estimates`` in the order of ``covariance`` (P, P), which is in their units; ``start``: what was found of signs."""

    estimates: list[Estimate]
    covariance: FloatArray
    start: Start
    config: Config

    def __getitem__(self, name: str) -> Estimate:
        return next(e for e in self.estimates if e.name == name)

    @property
    def significant(self) -> list[Estimate]:
        return [e for e in self.estimates if e.significant]

    def since(self, first: Calibration) -> Calibration:
        """The same, seen from what the first pass assumed, and what that found of the wheels' signs."""
        estimates = [
            replace(e, before=was.before) for e, was in zip(self.estimates, first.estimates, strict=True)
        ]
        return replace(self, estimates=estimates, start=first.start, config=first.config)

    def settings(self) -> dict[str, dict[str, float | bool]]:
        """Stage, key and value of all that is observable and that a setting exists for."""
        out: dict[str, dict[str, float | bool]] = {}
        keys = {
            "radius_left": ("wheels", "radius_left_m"),
            "radius_right": ("wheels", "radius_right_m"),
            "track": ("wheels", "track_m"),
            "mount_x": ("sensor", "mount_x_m"),
            "mount_y": ("sensor", "mount_y_m"),
            "mount_yaw": ("sensor", "mount_yaw_deg"),
            "delay": ("sensor", "transport_delay_s"),
        }
        for e in self.estimates:
            if e.name in keys and e.observable:
                stage, key = keys[e.name]
                out.setdefault(stage, {})[key] = round(float(e.value), 6)
        if self.start.words:
            wheels = out.setdefault("wheels", {})
            left, right = self.start.signs
            if left[0] == 0.0:
                wheels["swap_sides"] = not self.config.wheels.swap_sides
            if left.sum() < 0.0:
                wheels["left_reversed"] = not self._reversed_now("left")
            if right.sum() < 0.0:
                wheels["right_reversed"] = not self._reversed_now("right")
        return out

    def _reversed_now(self, side: str) -> bool:
        return bool(getattr(self.config.wheels, f"{side}_reversed"))

    def lines(self) -> Iterator[str]:
        if self.start.words:
            yield f"WARNING        {self.start.words}"
        for e in self.estimates:
            yield e.line()

    def as_json(self) -> dict[str, Any]:
        wheels = {"wheels_found": self.start.words} if self.start.words else {}
        return wheels | {e.name: e.as_json() for e in self.estimates}

    def yaml(self, logs: str) -> str:
        """A file for ``--config``."""
        out = [
            f"# By `mfslam calibrate {logs}`: one sigma and what was assumed before stand beside each value."
        ]
        known = {
            "radius_left_m": "radius_left", "radius_right_m": "radius_right", "track_m": "track",
            "mount_x_m": "mount_x", "mount_y_m": "mount_y", "mount_yaw_deg": "mount_yaw",
            "transport_delay_s": "delay",
        }  # fmt: skip
        for stage, values in self.settings().items():
            out.append(f"{stage}:")
            for key, value in values.items():
                text = str(value).lower() if isinstance(value, bool) else f"{value:.6g}"
                beside = ""
                if key in known:
                    e = self[known[key]]
                    beside = f"   # +- {e.sigma:.2g}, was {e.before:.6g}"
                out.append(f"  {key}: {text}{beside}")
        for e in self.estimates:
            if not e.observable or e.name not in known.values():
                out.append(f"# {e.line()}")
        return "\n".join(out) + "\n"


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
    relative = {
        "radius_left": wheels.radius_left_m,
        "radius_right": wheels.radius_right_m,
        "track": wheels.track_m,
    }
    factors = np.array([nominal.get(name, 1.0) for name in solved.names])
    covariance = solved.covariance * np.outer(factors, factors)
    estimates = []
    for n, name in enumerate(solved.names):
        offset = config.sensor.transport_delay_s if name == "delay_s" else 0.0
        short = name.removesuffix("_m").removesuffix("_s").removesuffix("_rad")
        assumed, value = (float(v * factors[n] + offset) for v in (before[name], solved.values[n]))
        estimates.append(
            Estimate(short, assumed, value, math.sqrt(covariance[n, n]), relative.get(name, 1.0))
        )
    return Calibration(estimates, covariance, start, config)
