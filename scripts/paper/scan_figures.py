"""Figures 10, 11, 12 and 15 of the paper, from our runs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from drivers.simulator import Motion
from drivers.simulator.simulate import cast_scans
from mfslam import se2
from mfslam.config import DeskewConfig
from mfslam.deskew import deskew
from mfslam.types import FloatArray, Scan
from paper import pictures
from paper.displacement import SPEEDS_M_S, VARIANTS, mean_by_beam, steady_scans
from paper.rig import SPOKEN, SQUARE, Drive, H, drive_through, settings_of, wheel_twists

BOXES_M = {
    SQUARE: (14.8, 24.8, 15.0, 25.0),
    H: (13.8, 23.8, 8.0, 18.0),
}  # drawn large: a fast stretch, a turn
OVERLAY_M = 1.5  # a scan every so far is drawn


def draw(
    drive: Drive, displaced: dict[str, FloatArray], log_seed: int, folder: Path, worlds: tuple[str, ...]
) -> list[str]:
    """Draw all figures of ``worlds`` into ``folder``; their lines of the page."""
    log = drive.log(log_seed)
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
        pictures.draw_world(world, _overlay(world, OVERLAY_M), BOXES_M[name], folder / f"{name}.png")
        body += [
            f"![{name}]({name}.png)",
            f"*Figures 10 and {11 if name == SQUARE else 15}, the {SPOKEN[name]}: the route by speed, scans as snapshots on "
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
    scans = drive.exact_scans(range(len(drive.instants_s)))
    clouds = [deskew(scans[n], np.zeros(3), DeskewConfig(mode="none")).points_m for n in first]
    poses = drive.world_T_body[first]
    snapshots = [se2.transform(pose, cloud) for pose, cloud in zip(poses, clouds, strict=True)]
    true = drive.hits_m[first].reshape(-1, 2)
    return true[np.isfinite(true[:, 0])], np.concatenate(snapshots)
