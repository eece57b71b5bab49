"""Where hits lie against where they truly are, by variant of compensation, beam by beam."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mfslam.config import DeskewConfig
from mfslam.deskew import beam_times_s, deskew
from mfslam.types import BoolArray, FloatArray
from paper.rig import Drive, rms, run_engine, settings_of, wheel_twists

SPEEDS_M_S = (1.0, 2.0, 3.0)
STEADY_M_S, STEADY_RAD_S = 0.02, 0.05  # a scan within this of its speed, and turning no faster, is steady

NONE, RANGE, WHEELS_POSE, OPTIMISED = "none", "range", "pose, wheels", "pose, optimised"
VARIANTS = {
    NONE: "not compensated",
    RANGE: "range variant (19-24), wheel motion",
    WHEELS_POSE: "pose variant (14-18), wheel motion",
    OPTIMISED: "pose variant (14-18), optimised motion",
}


@dataclass(frozen=True)
class ErrorFigures:
    """Of displacements in the body frame, m. ``systematic_rms``: of their mean per beam over all scans, what
    noise of the encoders does not average away. ``last_x``, ``last_y``: that mean at the last beam, along and
    across the driving. ``rms``, ``max``: of all."""

    scans: int
    last_x_m: float
    last_y_m: float
    systematic_rms_m: float
    rms_m: float
    max_m: float

    @staticmethod
    def of(displacements_m: FloatArray) -> ErrorFigures:
        """``displacements_m`` (S, B, 2), NaN where a beam met nothing."""
        mean = mean_by_beam(displacements_m)
        length = np.hypot(displacements_m[..., 0], displacements_m[..., 1])
        return ErrorFigures(
            scans=len(displacements_m),
            last_x_m=float(mean[-1, 0]),
            last_y_m=float(mean[-1, 1]),
            systematic_rms_m=rms(np.hypot(*mean.T)),
            rms_m=rms(length),
            max_m=float(np.nanmax(length)),
        )


def mean_by_beam(displacements_m: FloatArray) -> FloatArray:
    """(B, 2) mean over the scans; NaN for beams that met nothing in half of them or more."""
    often = np.isfinite(displacements_m[..., 0]).mean(axis=0) > 0.5
    out = np.full(displacements_m.shape[1:], np.nan)
    out[often] = np.nanmean(displacements_m[:, often], axis=0)
    return out


def displacements(drive: Drive, twists: FloatArray, settings: DeskewConfig) -> FloatArray:
    """(S, B, 2) where a variant puts each noise-free hit less where it truly is, body frame at the scan's
    reference instant."""
    out = np.full(drive.points_m.shape, np.nan)
    for n, scan in enumerate(drive.exact_scans(range(len(twists)))):
        cloud = deskew(scan, twists[n], settings)
        out[n, cloud.beams] = cloud.points_m - drive.points_m[n, cloud.beams]
    return out


def all_displacements(drive: Drive, seed: int) -> dict[str, FloatArray]:
    """Of every variant, with the wheels' readings (256 pulses, slip, wrong radii) of one log."""
    log, settings = drive.log(seed), settings_of()
    wheels = wheel_twists(log.messages, settings)
    _, solution = run_engine(log.messages, settings)
    return {
        NONE: displacements(drive, wheels, DeskewConfig(mode="none")),
        RANGE: displacements(drive, wheels, DeskewConfig(mode="range")),
        WHEELS_POSE: displacements(drive, wheels, DeskewConfig(mode="pose")),
        OPTIMISED: displacements(drive, solution.twists, DeskewConfig(mode="pose")),
    }


def steady_scans(drive: Drive, speed_m_s: float) -> BoolArray:
    """(S,) scans through all of which the robot drives straight at one speed."""
    span_s = float(np.ptp(beam_times_s(drive.laser.laser)))
    ends = np.stack([drive.instants_s, drive.instants_s + span_s], axis=-1)
    twists = drive.motion.twist_at(ends)
    same = np.abs(twists[..., 0] - speed_m_s) < STEADY_M_S
    return np.asarray(np.all(same & (np.abs(twists[..., 2]) < STEADY_RAD_S), axis=1))
