"""What a simulated log cannot tell its reader, as arguments of `mfslam map`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from drivers.logs import default_presets
from drivers.simulator.sensors import laser_preset, laser_timing
from drivers.simulator.settings import Settings
from drivers.writers.log import Format
from mfslam.settings import load, preset_path


def map_arguments(log: Path, kind: Format, settings: Settings) -> list[str]:
    """Preset and settings of sensor and wheels that a written log leaves open or its format would assume.

    Faults are not among them: whoever reads a log does not know those.
    """
    presets, preset = default_presets(log), laser_preset(settings.laser.name)
    arguments = [] if preset in (*presets, "generic") else ["--preset", preset]
    assumed = load([preset_path(name) for name in (*presets, *arguments[1:])])
    for stage, needed in (("sensor", _sensor(kind, settings)), ("wheels", _wheels(kind, settings))):
        known = getattr(assumed, stage)
        for key, value in needed.items():
            if (getattr(known, key) or 0) != value:  # a mount that is not set is 0
                arguments += ["--set", f"{stage}.{key}={_text(value)}"]
    return arguments


def _text(value: bool | float | str) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    return value if isinstance(value, str) else f"{value:.9g}"


def _sensor(kind: Format, settings: Settings) -> dict[str, Any]:
    laser = settings.laser
    own = load([preset_path(laser_preset(laser.name))]).sensor
    needed: dict[str, Any] = {
        "range_sigma_m": laser.range_sigma_m or own.range_sigma_m,
        "transport_delay_s": own.transport_delay_s,
        "stamp_at": own.stamp_at,
    }
    turn_s = laser_timing(laser.name)[0] * laser.stretch
    if kind.startswith(
        "ros"
    ):  # LaserScan tells the timing: rays as they are sensed, the stamp that of the first
        needed |= {"stamp_at": "first", "reversed_beams": False}
        return needed | ({} if own.turn_period_s is None else {"turn_period_s": turn_s})
    needed["turn_period_s"] = turn_s
    needed["reversed_beams"] = own.reversed_beams != laser.reversed_beams
    if kind == "urg-text":
        x, y, yaw = laser.told_mount
        needed |= {"mount_x_m": x, "mount_y_m": y, "mount_yaw_deg": yaw}
    return needed


def _wheels(kind: Format, settings: Settings) -> dict[str, Any]:
    robot = settings.robot
    if robot.odometry not in ("ticks", "angles"):
        return {}
    keys = ("radius_left_m", "radius_right_m", "track_m")
    needed: dict[str, Any] = {key: getattr(robot.wheels, key) for key in keys}
    if kind == "urg-text":
        needed["ticks_per_turn"] = robot.wheels.ticks_per_turn
        needed["swap_sides"] = robot.wheels.swap_sides
    return needed
