"""What the front end is told of each scan, and what it makes of it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from mfslam.types import DeskewedScan, FloatArray, Match

POOR_FIT, GOOD_FIT = 0.25, 0.65  # inlier ratios between which a match gains its full weight


@dataclass(frozen=True, eq=False, slots=True)
class PredictedMotion:
    """What is known of the motion before a scan is matched.

    ``twist`` (3,): body velocity during the scan. ``dt_s``: time since the previous scan. ``step`` (3,):
    wheel motion since the previous scan; None without wheels. ``turn_rad``: the gyro's turn since then.
    ``noise_scale`` (3,): how many times noisier than configured the wheels turned out to be. ``pause_s``:
    what may have passed since the previous scan beyond ``dt_s``.
    """

    twist: FloatArray
    dt_s: float
    step: FloatArray | None = None
    turn_rad: float | None = None
    noise_scale: FloatArray = field(default_factory=lambda: np.ones(3))
    pause_s: float = 0.0


NOTHING_KNOWN = PredictedMotion(np.zeros(3), 0.0)


@dataclass(eq=False, slots=True)
class Keyframe:
    """A scan that the graph holds a pose for."""

    scan_index: int
    cloud: DeskewedScan
    local_T_body: FloatArray


@dataclass(eq=False, slots=True)
class Step:
    """What the front end made of one scan.

    ``blind_s``: how long nothing had told where the robot goes, when it was found again or given up; else 0.
    ``found``: whether it was found again; if not, nothing ties this scan to those before.
    ``twist`` (3,): motion through the scan that it was deskewed with; None: as predicted.
    ``unseen`` (3, 3): covariance of the way since the last keyframe where no scan tells it, by inertia.
    """

    local_T_body: FloatArray
    match: Match | None
    is_keyframe: bool
    searched: bool = False
    odometry_jump: bool = False
    blind_s: float = 0.0
    found: bool = True
    twist: FloatArray | None = None
    unseen: FloatArray | None = None


def trust(match: Match) -> float:
    """Share of a match's information that its fit leaves."""
    return min(max((match.inlier_ratio - POOR_FIT) / (GOOD_FIT - POOR_FIT), 0.02), 1.0) ** 2
