"""The error within one scan: how far its hits lie from where they truly are, by speed and by compensation."""

from __future__ import annotations

from typing import Any

import numpy as np

from mfslam.types import FloatArray
from paper.displacement import (
    NONE,
    OPTIMISED,
    RANGE,
    SPEEDS_M_S,
    VARIANTS,
    WHEELS_POSE,
    ErrorFigures,
    all_displacements,
    steady_scans,
)
from paper.rig import SQUARE, Drive, H, drive_through, true_twists
from paper.scan_figures import draw
from paper.section import Claim, Effort, Section

SEED = 1
QUICK_S = 40.0  # the first three sides, at 1, 2 and 3 m/s
TURNING_RAD_S = 0.5
BAR = 1.0 / 20.0


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
            f"{1e3 * at3[NONE].systematic_rms_m:.0f} mm left, 1/{1 / ratio:.0f} "
            f"(with the optimised motion {1e3 * at3[OPTIMISED].systematic_rms_m:.1f} mm)",
            ratio < BAR,
            "what is left is the wheels' own error of scale and turn, which noise does not average away",
        )
    )
    turns, straight = figures["turns"][NONE].rms_m, figures["1 m/s"][NONE].rms_m
    out.append(
        Claim(
            "The scan's error grows around corners",
            f"{1e3 * turns:.0f} mm RMS in turns, against {1e3 * straight:.0f} mm straight on at 1 m/s",
            turns > straight,
            "a turn moves far hits sideways by range times angle",
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
        body += draw(drive, displaced, SEED, effort.figures, (SQUARE,) if effort.quick else (SQUARE, H))
    measured: dict[str, Any] = {
        part: {variant: vars(f) for variant, f in variants.items()} for part, variants in figures.items()
    }
    return Section("The error within a scan", "\n\n".join(body), claims_of(figures), measured)
