"""Models of laser range finders: geometry, timing, noise and what the log gets wrong of them."""

from __future__ import annotations

import difflib
from dataclasses import dataclass

import numpy as np

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


@dataclass(frozen=True)
class _Spec:
    beams: int
    angle_min_deg: float
    angle_step_deg: float
    turn_period_s: float
    period_s: float
    range_min_m: float
    range_max_m: float
    range_sigma_m: float
    range_step_m: float
    interlace: int = 1
    clockwise: bool = False
    no_return_is_inf: bool = True


# Datasheet figures; period_s is what the usual serial link or driver delivers.
_SPECS: dict[str, _Spec] = {
    "urg-04lx": _Spec(682, -119.53125, 0.3515625, 0.1, 0.1, 0.06, 4.0, 0.02, 0.001, no_return_is_inf=False),
    "utm-30lx": _Spec(1081, -135.0, 0.25, 0.025, 0.025, 0.1, 30.0, 0.01, 0.001),
    "sick-lms200": _Spec(181, -90.0, 1.0, 1.0 / 75.0, 0.2, 0.05, 50.0, 0.01, 0.01),
    "sick-lms291": _Spec(361, -90.0, 0.5, 1.0 / 75.0, 0.2, 0.05, 50.0, 0.01, 0.01, interlace=2),
    "rplidar-a1": _Spec(360, -180.0, 1.0, 0.1818, 0.1818, 0.15, 12.0, 0.02, 0.00025, clockwise=True),
    "rplidar-a2": _Spec(400, -180.0, 0.9, 0.1, 0.1, 0.2, 16.0, 0.02, 0.00025, clockwise=True),
    "generic": _Spec(360, -180.0, 1.0, 0.1, 0.1, 0.05, 20.0, 0.02, 0.001),
    "fast": _Spec(721, -135.0, 0.375, 0.1, 0.1, 0.06, 10.0, 0.02, 0.001),
}


def laser_model_names() -> list[str]:
    return sorted(_SPECS)


def laser_model(name: str, body_T_laser: FloatArray | tuple[float, float, float] = (0, 0, 0)) -> LaserModel:
    """A known sensor by its name, mounted at ``body_T_laser`` (3,).

    Beam k is sensed at its angle from the first sensed beam over 2 pi, times the mirror's turn (eq. 15);
    interlaced beams one turn later each. The instant of a scan is that of its first sensed beam.
    """
    if name not in _SPECS:
        near = difflib.get_close_matches(name, _SPECS, n=1)
        hint = f"; did you mean {near[0]}?" if near else ""
        raise MfslamError(f"no laser model {name!r}{hint} Known: {', '.join(laser_model_names())}")
    spec = _SPECS[name]
    beam = np.arange(spec.beams, dtype=np.float64)
    order = beam[::-1] if spec.clockwise else beam
    turn = order * (spec.angle_step_deg / 360.0)  # eq. 15, in mirror turns
    laser = Laser(
        name=name,
        angles_rad=np.radians(spec.angle_min_deg + beam * spec.angle_step_deg),
        offsets_s=(turn + order % spec.interlace) * spec.turn_period_s,
        range_min_m=spec.range_min_m,
        range_max_m=spec.range_max_m,
        range_sigma_m=spec.range_sigma_m,
        body_T_laser=np.asarray(body_T_laser, dtype=np.float64),
    )
    return LaserModel(
        laser=laser,
        period_s=spec.period_s,
        range_step_m=spec.range_step_m,
        no_return_is_inf=spec.no_return_is_inf,
    )
