"""Period and direction of the laser's turn, by the distortion that is left in scans of a turning robot.

A beam at the share u of a turn from the middle of its scan was sensed at u T. Deskewed with T0, its scan is distorted as
by a twist (T - T0) / T0 times that of the robot. Scans of fast turns are matched with surfaces seen while the robot
turned slowly, which are hardly distorted, pose and distortion at once (`icp.register_moving`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mfslam import icp, se2
from mfslam.calibration.regression import regressed
from mfslam.deskew import beam_times_s, deskew
from mfslam.slam import Slam, Solution
from mfslam.surfaces import merged_surface, placed
from mfslam.types import FloatArray, IntArray, Laser

LEAST_RAD_S, SLOW_SHARE = 0.4, 0.3  # a fast turn; of it, what a surface may be seen with
MOST_SCANS, LEAST_SCANS = 200, 20
# keyframes of one surface, how far off, how many of them before and after
SURFACES, REACH_M, NEAR = 6, 3.0, 60
POSE_SIGMAS = np.array([0.05, 0.05, 0.05])
CHANGE_S = 0.2  # of the period, one sigma, before anything is known
USUAL_PERIOD_S = 0.1
LEAST_RAD = 1e-9  # spread of the distortions' errors
SYSTEMATIC_SHARE = 0.05  # of the period: surfaces are distorted, too


@dataclass(frozen=True, eq=False)
class LaserTurn:
    """``period_s`` as found, negative where the laser turns against the order assumed; ``sigma_s``."""

    assumed_s: float
    period_s: float
    sigma_s: float


def assumed_period_s(laser: Laser) -> float:
    """Period of a turn by which the beams were timed; 0 for a snapshot."""
    duration_s, span_rad = float(np.ptp(laser.offsets_s)), float(np.ptp(laser.angles_rad))
    return 2.0 * math.pi * duration_s / span_rad if span_rad > 0.0 else 0.0


def find_turn(slam: Slam, solution: Solution) -> LaserTurn | None:
    """None where the robot hardly turns, or not near a place that it saw without turning."""
    laser = slam.scans[0].laser
    period_s = assumed_period_s(laser)
    if slam.config.deskew.mode != "pose" or len(laser.angles_rad) < 2:
        return None
    shares = beam_times_s(laser) / period_s if period_s > 0.0 else _shares_in_order(laser)
    yaw_rates = solution.twists[:, 2]
    fast = np.flatnonzero(np.abs(yaw_rates) > LEAST_RAD_S)
    fast = fast[:: max(1, math.ceil(len(fast) / MOST_SCANS))]
    rates, changes = [], []
    for n in fast.tolist():
        change = _distortion(slam, solution, n, shares)
        if change is not None:
            rates.append(yaw_rates[n])
            changes.append(change)
    if len(rates) < LEAST_SCANS:
        return None
    slope, variance = regressed(np.array(rates)[:, None], np.array(changes), LEAST_RAD)
    more_s, sigma_s = float(slope[0]), math.sqrt(float(variance[0, 0]))
    sigma_s = math.hypot(sigma_s, SYSTEMATIC_SHARE * (abs(more_s) + (period_s or USUAL_PERIOD_S)))
    return LaserTurn(period_s, period_s + more_s, sigma_s)


def _shares_in_order(laser: Laser) -> FloatArray:
    """(N,) of beams of which no time is known: as if sensed in their order."""
    return np.asarray(np.abs(laser.angles_rad - laser.angles_rad[0]) / (2.0 * math.pi) - _half_span(laser))


def _half_span(laser: Laser) -> float:
    return 0.5 * float(np.ptp(laser.angles_rad)) / (2.0 * math.pi)


def _distortion(slam: Slam, solution: Solution, n: int, shares: FloatArray) -> float | None:
    """How much of a turn (rad) per turn of the laser is left in scan ``n``."""
    config, poses = slam.config, solution.world_T_reference
    members = _slow_keyframes(solution, n)
    if len(members) < 2:
        return None
    clouds = [
        deskew(slam.scans[k], solution.twists[k], config.deskew, config.icp.point_spacing_m)
        for k in members.tolist()
    ]
    surface = merged_surface([placed(*each) for each in zip(clouds, poses[members], strict=True)])
    cloud = deskew(slam.scans[n], solution.twists[n], config.deskew, config.icp.point_spacing_m)
    sigmas = np.concatenate([POSE_SIGMAS, CHANGE_S * np.array([1.0, 1.0, 2.0])])
    pose, change = icp.register_moving(
        surface, cloud, shares[cloud.beams], poses[n], poses[n], np.zeros(3), np.diag(sigmas**-2),
        slam.scans[n].laser.range_sigma_m, config.icp,
    )  # fmt: skip
    moved = se2.between(poses[n], pose)
    return float(change[2]) if change.any() and np.hypot(moved[0], moved[1]) < 0.2 else None


def _slow_keyframes(solution: Solution, n: int) -> IntArray:
    """Scans (M,) of keyframes around scan ``n`` in which the robot turned much more slowly; the nearest ones."""
    keyframes, poses = solution.keyframes, solution.world_T_reference
    here = int(np.searchsorted(keyframes, n))
    near = keyframes[max(0, here - NEAR) : here + NEAR]
    near = near[np.abs(solution.twists[near, 2]) < SLOW_SHARE * abs(solution.twists[n, 2])]
    far_m = np.hypot(*(poses[near, :2] - poses[n, :2]).T)
    return np.asarray(near[np.argsort(far_m, kind="stable")][:SURFACES][: np.count_nonzero(far_m < REACH_M)])
