"""The error within one scan: how far its hits lie from where they truly are, by speed and by compensation."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from drivers.simulator import Motion
from drivers.simulator.simulate import cast_scans
from mfslam import se2
from mfslam.config import DeskewConfig
from mfslam.deskew import beam_times_s, deskew
from mfslam.types import BoolArray, FloatArray, Scan
from paper import pictures
from paper.rig import (
    SQUARE,
    Drive,
    H,
    drive_through,
    rms,
    run_engine,
    settings_of,
    true_twists,
    wheel_twists,
)
from paper.section import Claim, Effort, Section

SEED = 1
QUICK_S = 40.0  # the first three sides, at 1, 2 and 3 m/s
SPEEDS_M_S = (1.0, 2.0, 3.0)
STEADY_M_S, STEADY_RAD_S = 0.02, 0.05  # a scan within this of its speed, and turning no faster, is steady
TURNING_RAD_S = 0.5
BAR = 1.0 / 20.0
BOXES_M = {
    SQUARE: (14.8, 24.8, 15.0, 25.0),
    H: (13.8, 23.8, 8.0, 18.0),
}  # drawn large: a fast stretch, a turn

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


def figures_of(drive: Drive, displaced: dict[str, FloatArray]) -> dict[str, dict[str, ErrorFigures]]:
    """By stretch of driving, then by variant."""
    turning = np.abs(true_twists(drive)[:, 2]) > TURNING_RAD_S
    parts = {f"{speed:g} m/s": steady_scans(drive, speed) for speed in SPEEDS_M_S}
    parts |= {"turns": turning, "whole drive": np.ones(len(turning), np.bool_)}
    return {
        part: {variant: ErrorFigures.of(moved[chosen]) for variant, moved in displaced.items()}
        for part, chosen in parts.items()
        if chosen.sum() >= 5
    }


# --- the page ------------------------------------------------------------------------------------------


def table(figures: dict[str, dict[str, ErrorFigures]]) -> str:
    lines = [
        "| driving | scans | variant | last beam x, mm | last beam y, mm | systematic, mm | RMS, mm | max, mm |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for part, variants in figures.items():
        for variant, f in variants.items():
            mm = [1e3 * v for v in (f.last_x_m, f.last_y_m, f.systematic_rms_m, f.rms_m, f.max_m)]
            # the mean per beam says something only where all scans move alike
            first = [f"{v:.1f}" for v in mm[:3]] if part.endswith("m/s") else ["", "", ""]
            cells = [part, str(f.scans), VARIANTS[variant], *first, f"{mm[3]:.1f}", f"{mm[4]:.1f}"]
            lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def claims_of(figures: dict[str, dict[str, ErrorFigures]]) -> list[Claim]:
    out = []
    lasts = {speed: -figures[f"{speed:g} m/s"][NONE].last_x_m for speed in SPEEDS_M_S}
    per_speed = [last / speed for speed, last in lasts.items()]
    out.append(
        Claim(
            "A scan's error grows with speed, up to 0.1 m per 1 m/s",
            ", ".join(f"{last:.3f} m at {speed:g} m/s" for speed, last in lasts.items()) + " (last beam)",
            bool(min(per_speed) > 0.9 * max(per_speed) and max(per_speed) <= 0.1),
            f"{max(per_speed):.3f} m per 1 m/s: the 240 deg take 66.6 ms, not the whole turn of 100 ms",
        )
    )
    at3 = figures["3 m/s"]
    ratio = at3[WHEELS_POSE].systematic_rms_m / at3[NONE].systematic_rms_m
    out.append(
        Claim(
            "Compensation removes the error of the motion (bar: under 1/20 of it left at 3 m/s)",
            f"pose variant: {1e3 * at3[WHEELS_POSE].systematic_rms_m:.1f} of "
            f"{1e3 * at3[NONE].systematic_rms_m:.0f} mm left, 1/{1 / ratio:.0f}",
            ratio < BAR,
            "what is left is the wheels' own error of scale and turn, which noise does not average away",
        )
    )
    ranged = at3[RANGE].systematic_rms_m / at3[NONE].systematic_rms_m
    out.append(
        Claim(
            "The correction of ranges (19-24) compensates the motion",
            f"{1e3 * at3[RANGE].systematic_rms_m:.0f} of {1e3 * at3[NONE].systematic_rms_m:.0f} mm left",
            ranged < 0.5,
            "one number along the beam, right only ahead: (cos a - 1, sin a) v t is left, so beyond 60 deg "
            "to the side it does more harm than good",
        )
    )
    return out


def run(effort: Effort) -> Section:
    drive = drive_through(SQUARE, QUICK_S if effort.quick else None)
    displaced = all_displacements(drive, SEED)
    figures = figures_of(drive, displaced)
    body = [
        "Where each variant puts a hit, less where it truly is, in the body frame at the instant of the scan's "
        "first beam; x is the driving direction. Ranges without noise, wheels as logged (256 pulses, slip, wrong radii), "
        "so that what is left is the compensation's own error. *Systematic*: root mean square over the beams "
        "of the mean over all scans.",
        table(figures),
    ]
    if effort.figures is not None:
        body += _draw(drive, displaced, effort.figures, (SQUARE,) if effort.quick else (SQUARE, H))
    measured: dict[str, Any] = {
        part: {variant: vars(f) for variant, f in variants.items()} for part, variants in figures.items()
    }
    return Section("The error within a scan", "\n\n".join(body), claims_of(figures), measured)


# --- figures -------------------------------------------------------------------------------------------


def _draw(drive: Drive, displaced: dict[str, FloatArray], folder: Path, worlds: tuple[str, ...]) -> list[str]:
    log = drive.log(SEED)
    wheels = wheel_twists(log.messages, settings_of())
    chosen = {speed: _telling_scan(drive, speed) for speed in SPEEDS_M_S}
    scans = {
        f"{speed:g} m/s": pictures.ScanTriple(
            stationary=_standing_points(drive, n),
            snapshot=deskew(log.scans[n], wheels[n], DeskewConfig(mode="none")).points_m,
            compensated=deskew(log.scans[n], wheels[n], DeskewConfig(mode="pose")).points_m,
        )
        for speed, n in chosen.items()
    }
    pictures.draw_scans(scans, folder / "scan-error.png")
    angles_deg = np.degrees(drive.laser.laser.angles_rad)
    at3 = steady_scans(drive, 3.0)
    pictures.draw_by_beam(
        angles_deg,
        {VARIANTS[v]: np.hypot(*mean_by_beam(moved[at3]).T) for v, moved in displaced.items()},
        folder / "error-by-beam.png",
    )
    body = [
        "![Scans against stationary scans](scan-error.png)",
        "*Figure 12 of the paper, from our runs: one scan at each speed against a stationary one from the same spot. "
        "Above as the sensor tells it, below with every beam from its own pose.*",
        "![Error by bearing](error-by-beam.png)",
        "*Systematic error of each beam at 3 m/s. The range variant is right ahead and wrong to the sides.*",
    ]
    for name in worlds:
        world = drive if name == SQUARE else drive_through(name)
        pictures.draw_world(world, _overlay(world, 1.5), BOXES_M[name], folder / f"{name}.png")
        body += [
            f"![{name}]({name}.png)",
            f"*Figures 10 and {11 if name == SQUARE else 15}, the {name.replace('-', ' ').replace('h ', 'H ')}: the route by speed, scans as snapshots on "
            "top of where their hits truly are, and the speed over time.*",
        ]
    return body


def _telling_scan(drive: Drive, speed_m_s: float) -> int:
    """The steady scan with the most hits ahead: errors along a bare wall do not show."""
    ahead = np.abs(drive.points_m[..., 0]) > 1.0
    score = np.sum(np.isfinite(drive.points_m[..., 0]) & ahead & (drive.points_m[..., 0] < 3.9), axis=1)
    return int(np.argmax(np.where(steady_scans(drive, speed_m_s), score, -1)))


def _standing_points(drive: Drive, n: int) -> FloatArray:
    """(M, 2) noise-free scan of a robot that stands where scan ``n`` began, body frame."""
    motion = Motion.from_twists([1.0], [(0.0, 0.0, 0.0)], drive.world_T_body[n])
    ranges = cast_scans(drive.world, motion, replace(drive.laser, noise=False), np.zeros(1))[0]
    standing = Scan(0, np.where(np.isfinite(ranges), ranges, np.nan).astype(np.float32), drive.laser.laser)
    return deskew(standing, np.zeros(3), DeskewConfig(mode="none")).points_m


def _overlay(drive: Drive, every_m: float) -> tuple[FloatArray, FloatArray]:
    """Hits (P, 2) in the world of a scan every so far: where they truly are, and as snapshots tell them."""
    travelled_m, _ = drive.motion.travel(drive.instants_s)
    first = np.unique((travelled_m / every_m).astype(np.int64), return_index=True)[1]
    snapshots = []
    for n, scan in enumerate(drive.exact_scans(range(len(drive.instants_s)))):
        if n in set(first.tolist()):
            cloud = deskew(scan, np.zeros(3), DeskewConfig(mode="none"))
            snapshots.append(se2.transform(drive.world_T_body[n], cloud.points_m))
    true = drive.hits_m[first].reshape(-1, 2)
    return true[np.isfinite(true[:, 0])], np.concatenate(snapshots)
