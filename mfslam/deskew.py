"""A raw scan and the motion during it -> points as if sensed at one instant (eqs. 14-18; 19-24)."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from mfslam.config import DeskewConfig
from mfslam.kernels import scans as kernels
from mfslam.types import DeskewedScan, FloatArray, Laser, Scan

STILL = np.zeros(3)


@lru_cache(maxsize=64)
def reference_offset_s(laser: Laser) -> float:
    """Instant that a scan's points are carried to, relative to its stamp: the middle of the scan. A twist that is a
    little wrong bends the scan about its middle, and hardly moves it."""
    return 0.5 * float(laser.offsets_s.min() + laser.offsets_s.max())


@lru_cache(maxsize=64)
def beam_times_s(laser: Laser) -> FloatArray:
    """(N,) instants of the beams from the scan's reference instant."""
    return laser.offsets_s - reference_offset_s(laser)


@lru_cache(maxsize=64)
def acceleration_lever_s2(laser: Laser) -> float:
    """Error of a scan's pose per acceleration that its deskewing does not know, s^2: T^2 / 24 of a scan of duration T.

    A beam at time t from the middle is off by a t^2 / 2; matching sees the mean of that.
    """
    return 0.5 * float(np.mean(np.square(beam_times_s(laser))))


def deskew(
    scan: Scan, body_twist: FloatArray, config: DeskewConfig, spacing_m: float = 0.0, doubtful: bool = False
) -> DeskewedScan:
    """Points of ``scan`` in the body frame at its reference instant.

    ``body_twist`` (3,): m/s, m/s, rad/s, taken as constant through the scan; or (6,): that at its reference instant,
    followed by its change per second. ``spacing_m``: points in
    beam order are thinned to this spacing after their normals were estimated. ``doubtful``: normals that may be wrong, too.
    """
    laser = scan.laser
    times_s = beam_times_s(laser)
    ranges_m = scan.ranges_m
    twist = twist_through(body_twist, config)
    if config.mode == "range":
        # eqs. 19-24: e_d = v (t_j - t_ref), one number along the beam whatever its bearing
        ranges_m = (ranges_m + body_twist[0] * times_s).astype(np.float32)
    points, normals, beams = kernels.oriented_points(
        ranges_m, beam_directions(laser), times_s, laser.body_T_laser, twist, laser.range_min_m, laser.range_max_m,
        beam_step_rad(laser), laser.range_sigma_m, spacing_m, doubtful,
    )  # fmt: skip
    reference_ns = scan.stamp_ns + round(reference_offset_s(laser) * 1e9)
    return DeskewedScan(reference_ns, points, normals, beams)


def twist_through(body_twist: FloatArray, config: DeskewConfig) -> FloatArray:
    """The motion that a scan's points are carried by."""
    return body_twist if config.mode == "pose" else STILL


@lru_cache(maxsize=64)
def beam_step_rad(laser: Laser) -> float:
    """Angle from beam to beam; 0 of a single one."""
    return float(np.median(np.abs(np.diff(laser.angles_rad)))) if laser.angles_rad.size > 1 else 0.0


@lru_cache(maxsize=64)
def beam_directions(laser: Laser) -> FloatArray:
    """(N, 2) unit vectors along the beams, in the axes of the body."""
    bearings_rad = laser.angles_rad + laser.body_T_laser[2]
    return np.stack([np.cos(bearings_rad), np.sin(bearings_rad)], axis=1)
