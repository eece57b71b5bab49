"""The simulator's settings as a user writes them: YAML files and ``stage.key=value``, checked like a config.

Layers, later ones win: defaults, a named robot, what the log's format demands, a YAML file, settings.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from drivers.simulator.faults import Faults
from drivers.simulator.robot import ROBOTS, RobotModel
from drivers.simulator.sensors import LaserModel, laser_model, laser_model_names, laser_timing
from mfslam.config import WheelsConfig
from mfslam.settings import KeyPath, Layers, did_you_mean
from mfslam.types import MfslamError

_WHEEL_KEYS = ("radius_left_m", "radius_right_m", "track_m", "ticks_per_turn", "swap_sides")


class LaserSettings(BaseModel):
    """The laser: a known model, its mount, and what is different or wrong about it."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    name: str = Field("generic", description=f"Model: {', '.join(laser_model_names())}.")
    mount_x_m: float = Field(0.0, description="Laser ahead of the body's origin, m.")
    mount_y_m: float = Field(0.0, description="Laser left of the body's origin, m.")
    mount_yaw_deg: float = Field(0.0, description="Laser's heading on the body, deg.")
    told_mount_x_m: float | None = Field(None, description="What the log says of it, m. Null: the truth.")
    told_mount_y_m: float | None = Field(None, description="What the log says of it, m. Null: the truth.")
    told_mount_yaw_deg: float | None = Field(
        None, description="What the log says of it, deg. Null: the truth."
    )
    scan_rate_hz: float | None = Field(
        None, gt=0, description="Scans per second, the mirror turning accordingly, Hz. Null: the model's."
    )
    reversed_beams: bool = Field(False, description="It turns the other way than the model does.")
    range_max_m: float | None = Field(None, gt=0, description="It sees so far, m. Null: as the model.")
    range_sigma_m: float | None = Field(
        None, ge=0, description="One-sigma noise of one range, m. Null: the model's."
    )
    range_step_m: float | None = Field(
        None, ge=0, description="Resolution of a range, m; 0: none. Null: the model's."
    )
    no_return_is_inf: bool | None = Field(
        None,
        description="Beams that meet nothing are told as such (true) or lost as an error code (false). Null: as the "
        "model.",
    )
    error_share: float = Field(0.0, ge=0, le=1, description="Share of beams that end in an error code.")
    mixed_share: float = Field(
        0.0, ge=0, le=1, description="Share of edges at which a beam tells a range between the two surfaces."
    )
    stamp_delay_s: float = Field(
        0.0, description="Stamps are late by this against the wheels' clock, s: t_ND (eq. 15) is minus this."
    )
    clock_drift: float = Field(0.0, gt=-1, description="The laser's clock gains so much, s per s.")

    def model(self) -> LaserModel:
        """The laser that these settings describe. Raises MfslamError for an unknown name."""
        base = laser_model(self.name, (self.mount_x_m, self.mount_y_m, math.radians(self.mount_yaw_deg)))
        laser, stretch = base.laser, self.stretch
        offsets = laser.offsets_s[::-1] if self.reversed_beams else laser.offsets_s
        laser = dataclasses.replace(
            laser,
            offsets_s=offsets * stretch,
            range_max_m=self.range_max_m or laser.range_max_m,
            range_sigma_m=self.range_sigma_m or laser.range_sigma_m,
        )
        x, y, yaw_deg = self.told_mount
        told = np.array([x, y, math.radians(yaw_deg)])
        honest = np.array_equal(told, laser.body_T_laser)
        return LaserModel(
            laser=laser,
            period_s=base.period_s * stretch,
            reported=None if honest else dataclasses.replace(laser, body_T_laser=told),
            range_step_m=base.range_step_m if self.range_step_m is None else self.range_step_m,
            noise=self.range_sigma_m != 0.0,
            error_share=self.error_share,
            no_return_is_inf=base.no_return_is_inf
            if self.no_return_is_inf is None
            else self.no_return_is_inf,
            stamp_delay_s=self.stamp_delay_s,
            clock_drift=self.clock_drift,
            mixed_share=self.mixed_share,
        )

    @property
    def stretch(self) -> float:
        """How much slower than the model it turns."""
        return 1.0 if self.scan_rate_hz is None else 1.0 / (self.scan_rate_hz * laser_timing(self.name)[1])

    @property
    def told_mount(self) -> tuple[float, float, float]:
        """x, y (m), yaw (deg) as the log says."""
        x, y, yaw_deg = self.told_mount_x_m, self.told_mount_y_m, self.told_mount_yaw_deg
        return (
            self.mount_x_m if x is None else x,
            self.mount_y_m if y is None else y,
            self.mount_yaw_deg if yaw_deg is None else yaw_deg,
        )


@dataclasses.dataclass(frozen=True)
class Settings:
    """Robot, laser and faults of one simulated log."""

    robot: RobotModel = dataclasses.field(default_factory=RobotModel)
    laser: LaserSettings = dataclasses.field(default_factory=LaserSettings)
    faults: Faults = dataclasses.field(default_factory=Faults)


def load_settings(
    robot: str = "wheels",
    demanded: Iterable[str] = (),
    files: Iterable[Path] = (),
    settings: Iterable[str] = (),
) -> Settings:
    """A named robot, overlaid by ``demanded`` settings, YAML files, and ``stage.key=value`` settings.

    Raises MfslamError with file and line (or the setting) for anything that is not understood.
    """
    if robot not in ROBOTS:
        raise MfslamError(
            f"no robot {robot!r}{did_you_mean(robot, ROBOTS) or '.'} Known: {', '.join(ROBOTS)}"
        )
    merged: dict[str, Any] = dataclasses.asdict(Settings(ROBOTS[robot]))
    merged["robot"]["wheels"] = ROBOTS[robot].wheels.model_dump()
    merged["laser"] = LaserSettings().model_dump()
    layers = Layers(merged)
    for setting in demanded:
        layers.set(setting)
    for file in files:
        layers.read(file)
    for setting in settings:
        if "=" not in setting:
            raise MfslamError(
                f"--set {setting}: expected stage.key=value, for example --set faults.drop_share=0.1"
            )
        layers.set(setting)
    return _checked(layers)


def _checked(layers: Layers) -> Settings:
    problems = []
    parts: dict[str, Any] = {}
    for stage, values in layers.values.items():
        if stage not in _STAGES:
            problems.append(_unknown((stage,), layers))
            continue
        if not isinstance(values, dict):
            problems.append(f"{layers.where((stage,))}: {stage}: expected keys below it, got {values!r}")
            continue
        strangers: list[KeyPath] = [(stage, key) for key in values if key not in _keys((stage,))]
        wheels = values.get("wheels")
        if stage == "robot" and isinstance(wheels, dict):
            strangers += [(stage, "wheels", key) for key in wheels if key not in WheelsConfig.model_fields]
        problems += [_unknown(path, layers) for path in strangers]
        if not strangers:
            try:
                parts[stage] = _STAGES[stage].validate_python(values)
            except ValidationError as error:
                problems += [_explain((stage, *map(str, e["loc"])), e["msg"], layers) for e in error.errors()]
    if problems:
        raise MfslamError("\n".join(problems))
    settings = Settings(**parts)
    laser = settings.laser.model().laser  # an unknown name is told here
    if laser.range_max_m <= laser.range_min_m:
        raise MfslamError(
            f"laser.range_max_m: expected more than the model's least range, {laser.range_min_m:g} m"
        )
    _refuse_idle(settings)
    return settings


def _refuse_idle(settings: Settings) -> None:
    """Settings that would do nothing beside the others are told, not ignored."""
    robot = settings.robot
    if settings.faults.odometry_jumps and robot.odometry != "pose":
        raise MfslamError(
            f"faults.odometry_jumps: only odometry poses can jump, robot.odometry is {robot.odometry}"
        )
    if robot.compass_sigma_rad is not None and robot.gyro_rate_hz == 0.0:
        raise MfslamError(
            "robot.compass_sigma_rad: headings come with the gyro's readings: set robot.gyro_rate_hz"
        )
    if robot.encoder_rate_hz is None and (robot.encoder_jitter_s or robot.encoder_phase_s):
        raise MfslamError(
            "robot.encoder_jitter_s, robot.encoder_phase_s: encoders read at the scans' stamps have neither: set "
            "robot.encoder_rate_hz"
        )


_STAGES: dict[str, TypeAdapter[Any]] = {
    "robot": TypeAdapter(RobotModel),
    "laser": TypeAdapter(LaserSettings),
    "faults": TypeAdapter(Faults),
}


def _explain(path: KeyPath, message: str, layers: Layers) -> str:
    message = message.removeprefix("Value error, ")
    if (
        len(path) > 2 and path[1].isidentifier() and path[1] != "wheels"
    ):  # an item of a list: say what it holds
        message += f"; {dict(_described(path[0]))[path[1]]}"
    return f"{layers.where(path)}: {'.'.join(path)}: {message}"


def _unknown(path: KeyPath, layers: Layers) -> str:
    known = _keys(path[:-1])
    message = f"no such setting{did_you_mean(path[-1], known)} (known here: {', '.join(known)})"
    return _explain(path, message, layers)


def _keys(path: KeyPath) -> list[str]:
    if path == ("robot", "wheels"):
        return list(_WHEEL_KEYS)
    return [key for key, _ in _described(path[0])] if path else list(_STAGES)


def _described(stage: str) -> Iterator[tuple[str, str]]:
    """Key and meaning of every setting of a stage."""
    for key, schema in _STAGES[stage].json_schema()["properties"].items():
        yield key, schema["description"]


def describe(settings: Settings | None = None) -> str:
    """All settings as YAML, every one with its meaning (and unit) as a comment."""
    settings = settings or Settings()
    out: list[str] = []
    for stage in _STAGES:
        values = getattr(settings, stage)
        out += [f"# {' '.join((type(values).__doc__ or '').split())}", f"{stage}:"]
        for key, meaning in _described(stage):
            out.append(f"  # {meaning}")
            value = getattr(values, key)
            if not isinstance(value, WheelsConfig):
                out.append(f"  {key}: {json.dumps(value)}")
                continue
            out.append(f"  {key}:")
            for name in _WHEEL_KEYS:
                out.append(f"    # {WheelsConfig.model_fields[name].description}")
                out.append(f"    {name}: {json.dumps(getattr(value, name))}")
        out.append("")
    return "\n".join(out)
