"""Thickness of planes, and what the motion through scans makes of it."""

import numpy as np
import pytest

from mfslam import se2
from mfslam.config import Config
from mfslam.deskew import reference_offset_s
from mfslam.metrics import compare_motions
from mfslam.types import Laser, Scan

SIGMA_M = 0.012


def scans_of_a_square_room(twist, n=60, sigma_m=SIGMA_M, silent=False):
    """Scans of a room of 6 m by 6 m, 0.1 s each, from poses about its middle, all at one twist; poses at the reference."""
    rng = np.random.default_rng(0)
    angles = np.radians(np.arange(-180.0, 180.0, 0.5))
    laser = Laser("ideal", angles, np.linspace(0.0, 0.1, 720), 0.05, 20.0, 0.01, np.zeros(3))
    poses = np.stack([rng.uniform(-1, 1, n), rng.uniform(-1, 1, n), rng.uniform(-3, 3, n)], axis=-1)
    scans = []
    for k, pose in enumerate(poses):
        times = laser.offsets_s - reference_offset_s(laser)
        at = se2.compose(pose, se2.exp(twist * times[:, None]))
        c, s = np.cos(at[:, 2] + angles), np.sin(at[:, 2] + angles)
        with np.errstate(divide="ignore"):
            to_x = (np.copysign(3.0, c) - at[:, 0]) / c
            to_y = (np.copysign(3.0, s) - at[:, 1]) / s
        ranges = np.fmin(to_x, to_y) + rng.normal(0.0, sigma_m, 720)
        scans.append(Scan(k, np.full(720, np.inf if silent else ranges).astype(np.float32), laser))
    return scans, poses


def test_planes_are_as_thick_as_the_noise_of_the_ranges():
    scans, poses = scans_of_a_square_room(np.zeros(3))
    still = np.zeros((60, 3))
    figures = compare_motions(scans, poses, {"only": still}, Config())["only"]
    # noise along the beam, by the cosine of the incidence across the wall: less than the whole of it
    assert 0.75 * SIGMA_M < figures["plane_thickness_median_m"] < SIGMA_M
    assert figures["plane_thickness_mean_m"] == pytest.approx(figures["plane_thickness_median_m"], rel=0.1)


def test_the_true_motion_makes_thinner_planes_fewer_cells_and_less_entropy():
    twist = np.array([0.8, 0.0, 1.5])
    scans, poses = scans_of_a_square_room(twist)
    motions = {
        "off": np.zeros((60, 3)),
        "half": np.tile(0.5 * twist, (60, 1)),
        "true": np.tile(twist, (60, 1)),
    }
    figures = compare_motions(scans, poses, motions, Config())
    assert list(figures) == ["off", "half", "true"]
    for key in ("cells", "entropy_bits", "plane_thickness_median_m", "plane_thickness_mean_m"):
        assert figures["true"][key] < figures["half"][key] < figures["off"][key]
    assert figures["true"]["plane_thickness_median_m"] < SIGMA_M
    assert figures["off"]["plane_thickness_median_m"] > 2.0 * SIGMA_M


def test_long_logs_are_sampled(monkeypatch):
    from mfslam.metrics import sharpness

    scans, poses = scans_of_a_square_room(np.zeros(3))
    still = {"only": np.zeros((60, 3))}
    expected = compare_motions(scans[::3], poses[::3], {"only": np.zeros((20, 3))}, Config())
    monkeypatch.setattr(sharpness, "MAX_BEAMS", 20 * 720)
    assert compare_motions(scans, poses, still, Config()) == expected


def test_without_hits_there_is_nothing_to_say():
    scans, poses = scans_of_a_square_room(np.zeros(3), n=3, silent=True)
    assert compare_motions(scans, poses, {"only": np.zeros((3, 3))}, Config()) == {}
    assert compare_motions([], np.zeros((0, 3)), {"only": np.zeros((0, 3))}, Config()) == {}
