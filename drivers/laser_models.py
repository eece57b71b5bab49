"""Build a `Laser` from the sensor's settings and from what the log tells: the one home of eqs. 14 and 15."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from mfslam import se2
from mfslam.config import SensorConfig
from mfslam.types import Float32Array, FloatArray, Laser

_TURN_RAD = 2.0 * math.pi
_SICK_STEP_RAD = math.radians(1.0)
_TINY_M = float(np.finfo(np.float32).smallest_normal)  # the least range that is one
_RANGE_MAX_M = 100.0  # no 2D laser for wheeled robots sees farther


@dataclass(frozen=True)
class LogGeometry:
    """What a log tells of its laser; None where it is silent.

    ``turn_period_s``: of the mirror, also where the field of view is less than a turn.
    ``body_T_laser``: x, y (m) and heading (rad) of the laser's x axis. ``upside_down``: its z axis points
    to the floor.
    """

    n_beams: int
    angle_min_rad: float
    angle_step_rad: float
    turn_period_s: float | None = None
    range_min_m: float | None = None
    range_max_m: float | None = None
    body_T_laser: tuple[float, float, float] | None = None
    upside_down: bool = False


def laser_from(sensor: SensorConfig, told: LogGeometry, *, name: str | None = None) -> Laser:
    """The laser of a log. A setting wins over what the log tells, which wins over the plain default.

    Range limits are the exception: the narrower of the two holds, since a log may have been recorded
    with the sensor in a shorter mode, and a setting may distrust far ranges.
    """
    angles = beam_angles(sensor, told)
    return Laser(
        name=_name(sensor, name),
        angles_rad=-angles if sensor.upside_down or told.upside_down else angles,
        offsets_s=beam_offsets(sensor, told, angles),
        range_min_m=max(sensor.range_min_m or 0.0, told.range_min_m or 0.0),
        range_max_m=min(sensor.range_max_m or _RANGE_MAX_M, told.range_max_m or _RANGE_MAX_M),
        range_sigma_m=sensor.range_sigma_m,
        body_T_laser=mount(sensor, told.body_T_laser),
    )


def as_told(laser: Laser, sensor: SensorConfig) -> Laser:
    """A laser of `laser_from` as its sensor alone tells of it: who reads a recording with the same settings adds delay
    and posture again."""
    return replace(
        laser,
        angles_rad=-laser.angles_rad if sensor.upside_down else laser.angles_rad,
        offsets_s=laser.offsets_s - sensor.transport_delay_s,
    )


def _name(sensor: SensorConfig, in_log: str | None) -> str:
    if in_log is None or sensor.name == "generic":
        return in_log or sensor.name
    return f"{in_log} ({sensor.name})"


def beam_angles(sensor: SensorConfig, told: LogGeometry) -> FloatArray:
    """(N,) bearings in the laser frame, as if it stood upright. Eq. 14, with the step
    (theta_E - theta_S)/(M - 1) given."""
    first = told.angle_min_rad if sensor.angle_min_deg is None else math.radians(sensor.angle_min_deg)
    step = told.angle_step_rad if sensor.angle_step_deg is None else math.radians(sensor.angle_step_deg)
    return np.asarray(first + step * np.arange(told.n_beams), dtype=np.float64)


def beam_offsets(sensor: SensorConfig, told: LogGeometry, angles_rad: FloatArray) -> FloatArray:
    """(N,) seconds from the scan's stamp to each beam: eq. 15 with theta_j counted from the beam that is
    sensed first, so that t_j - t_s = (theta_j - theta_S)/(2 pi) T_s + t_ND.

    An interlaced laser senses every n-th beam in one turn, the ones between in the turns that follow.
    """
    n = told.n_beams
    order = np.arange(n)[::-1] if sensor.reversed_beams else np.arange(n)
    period_s = told.turn_period_s if sensor.turn_period_s is None else sensor.turn_period_s
    step = abs(float(angles_rad[1] - angles_rad[0])) if n > 1 else 0.0
    offsets = (order * step / _TURN_RAD + np.arange(n) % _interlace(sensor, step)) * (
        period_s or 0.0
    )  # eq. 15
    duration_s = float(offsets.max(initial=0.0))
    stamp_share = {"first": 0.0, "middle": 0.5, "last": 1.0}[sensor.stamp_at]
    return np.asarray(offsets - stamp_share * duration_s + sensor.transport_delay_s, dtype=np.float64)


def _interlace(sensor: SensorConfig, step_rad: float) -> int:
    """Turns that make up one scan: as set; else a SICK LMS 2xx whose beams are closer than its mirror's
    step senses them in several turns."""
    if "interlace" in sensor.model_fields_set or not sensor.name.startswith("sick-lms2") or not step_rad:
        return sensor.interlace
    return max(1, round(_SICK_STEP_RAD / step_rad))


def mount(sensor: SensorConfig, told: tuple[float, float, float] | None) -> FloatArray:
    """body_T_laser (3,): each setting that is given, else the log's value, else 0."""
    x, y, yaw = told or (0.0, 0.0, 0.0)
    return np.array(
        [
            x if sensor.mount_x_m is None else sensor.mount_x_m,
            y if sensor.mount_y_m is None else sensor.mount_y_m,
            float(se2.wrap(yaw if sensor.mount_yaw_deg is None else math.radians(sensor.mount_yaw_deg))),
        ]
    )


def clean_ranges(ranges_m: Float32Array, laser: Laser) -> Float32Array:
    """Ranges as `Scan` wants them, changed in place: +inf at or beyond the laser's maximum (no return),
    NaN for what says nothing (zero, negative, not a number, nearer than the minimum)."""
    with np.errstate(invalid="ignore"):
        ranges_m[ranges_m >= laser.range_max_m] = np.inf
        useless = ~(ranges_m >= max(laser.range_min_m, _TINY_M))
    ranges_m[useless] = np.nan
    return ranges_m
