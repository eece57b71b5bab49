"""Models of laser range finders: geometry, timing, noise and what the log gets wrong of them."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from drivers.laser_models import LogGeometry, laser_from
from mfslam.settings import did_you_mean, load, preset_path
from mfslam.types import FloatArray, Laser, MfslamError


@dataclass(frozen=True, eq=False)
class LaserModel:
    """A laser as it truly is, and as its log tells it.

    ``laser``: the truth; its offsets count from the instant of the scan. ``period_s``: from scan to scan.
    ``reported``: the `Laser` that the log's scans carry, when that is not the truth (a wrong mount, say).
    ``range_step_m``: resolution of a range; 0 none. ``noise``: the laser's range_sigma_m applies.
    ``error_share``: share of beams that end in an error code (NaN). ``no_return_is_inf``: whether beams
    that meet nothing are told (+inf) or lost (NaN). ``stamp_delay_s``: stamps are late by this, against
    the wheels' clock (t_ND = -stamp_delay_s). ``clock_drift``: the laser's clock gains this, s per s.
    ``mixed_share``: share of the edges at which a beam tells a range between the two surfaces.
    """

    laser: Laser
    period_s: float
    reported: Laser | None = None
    range_step_m: float = 0.0
    noise: bool = True
    error_share: float = 0.0
    no_return_is_inf: bool = True
    stamp_delay_s: float = 0.0
    clock_drift: float = 0.0
    mixed_share: float = 0.0


def stamped_at_first(model: LaserModel) -> LaserModel:
    """The same laser whose scans bear the instant of the beam that is sensed first, as ROS logs have it."""
    first_s = float(model.laser.offsets_s.min())

    def shifted(laser: Laser) -> Laser:
        return dataclasses.replace(laser, offsets_s=laser.offsets_s - first_s)

    reported = None if model.reported is None else shifted(model.reported)
    return dataclasses.replace(model, laser=shifted(model.laser), reported=reported)


@dataclass(frozen=True)
class _Delivery:
    """What a preset leaves to the log: geometry told, rate of scans, resolution, fate of lost beams."""

    preset: str
    told: LogGeometry
    period_s: float
    range_step_m: float
    no_return_is_inf: bool = True


def _beams(
    count: int,
    first_deg: float,
    step_deg: float,
    turn_s: float | None = None,
    range_max_m: float | None = None,
) -> LogGeometry:
    return LogGeometry(
        n_beams=count,
        angle_min_rad=math.radians(first_deg),
        angle_step_rad=math.radians(step_deg),
        turn_period_s=turn_s,
        range_max_m=range_max_m,
    )


# Rates are what the usual serial link or driver delivers.
_DELIVERIES: dict[str, _Delivery] = {
    "urg-04lx": _Delivery("urg-04lx", _beams(682, -119.53125, 0.3515625), 0.1, 0.001, False),
    "utm-30lx": _Delivery("utm-30lx", _beams(1081, -135.0, 0.25), 0.025, 0.001),
    "sick-lms200": _Delivery("sick-lms200", _beams(181, -90.0, 1.0), 0.2, 0.01),
    "sick-lms291": _Delivery("sick-lms291", _beams(361, -90.0, 0.5), 0.2, 0.01),
    "rplidar-a1": _Delivery("rplidar-a1", _beams(360, -180.0, 1.0, 0.18), 0.18, 0.001),
    "rplidar-a2": _Delivery("rplidar-a2", _beams(400, -180.0, 0.9, 0.1), 0.1, 0.001),
    "generic": _Delivery("generic", _beams(360, -180.0, 1.0, 0.1, 20.0), 0.1, 0.001),
    "fast": _Delivery("generic", _beams(721, -135.0, 0.375, 0.1, 10.0), 0.1, 0.001),
}


def laser_model_names() -> list[str]:
    return sorted(_DELIVERIES)


def _delivery(name: str) -> _Delivery:
    if name not in _DELIVERIES:
        hint = did_you_mean(name, _DELIVERIES) or "."
        raise MfslamError(f"no laser model {name!r}{hint} Known: {', '.join(laser_model_names())}")
    return _DELIVERIES[name]


def laser_preset(name: str) -> str:
    """The mfslam preset that knows this model."""
    return _delivery(name).preset


def laser_timing(name: str) -> tuple[float, float]:
    """Period of one turn of the model's mirror, and from scan to scan, s."""
    delivery = _delivery(name)
    known = load([preset_path(delivery.preset)]).sensor.turn_period_s
    return known or delivery.told.turn_period_s or delivery.period_s, delivery.period_s


def laser_model(name: str, body_T_laser: FloatArray | tuple[float, float, float] = (0, 0, 0)) -> LaserModel:
    """A known sensor by its name, mounted at ``body_T_laser`` (3,): the preset's geometry, timing and noise.

    The instant of a scan is that of its first sensed beam.
    """
    delivery = _delivery(name)
    sensor = load([preset_path(delivery.preset)]).sensor
    laser = laser_from(sensor, delivery.told, name=name)
    return LaserModel(
        laser=dataclasses.replace(laser, body_T_laser=np.asarray(body_T_laser, dtype=np.float64)),
        period_s=delivery.period_s,
        range_step_m=delivery.range_step_m,
        no_return_is_inf=delivery.no_return_is_inf,
    )
