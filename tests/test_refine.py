"""The second pass: what the adjustment is given of the graph, and scans in between."""

from __future__ import annotations

import numpy as np
import pytest

from mfslam import refine, se2
from mfslam.adjustment import ScanPoints
from mfslam.config import Config
from mfslam.deskew import deskew
from mfslam.step_records import Keyframe
from mfslam.types import Edge
from mfslam.wheel_errors import WheelErrors
from tests.rooms import ROOM, ROOM_PILLARS, laser, moving_scan

TWIST = np.array([0.6, 0.0, 0.5])


def drive(count=25, dt_s=0.1):
    """Scans of a robot on an arc through the room, and its true poses at their stamps."""
    model = laser(turn_s=0.08)
    poses = se2.compose(np.array([-1.5, -0.8, 0.0]), se2.exp(dt_s * np.arange(count)[:, None] * TWIST))
    return [moving_scan(ROOM, ROOM_PILLARS, pose, TWIST, model) for pose in poses], poses


def clouds_of(scans):
    return [deskew(scan, TWIST, Config().deskew, 0.05) for scan in scans]


def points_of(scans):
    return ScanPoints.of(
        clouds_of(scans), sum(len(scan.ranges_m) for scan in scans), np.zeros((len(scans), 2)),
        [scan.laser.range_max_m - scan.ranges_m for scan in scans],
    )  # fmt: skip


def chain(truth, information):
    """Scan edges between successive poses."""
    return [
        Edge("scan", k, k + 1, se2.between(truth[k], truth[k + 1]), information)
        for k in range(len(truth) - 1)
    ]


def refinement(edges):
    config = Config()
    return refine.Refinement(config, edges, [], WheelErrors(config.odometry), 0.01)


def test_rounds_bring_a_bent_estimate_to_the_truth():
    scans, truth = drive(12)
    bent = se2.compose(truth, se2.exp(np.random.default_rng(1).normal(0.0, [0.05, 0.05, 0.02], (12, 3))))
    bent[0] = truth[0]
    rounds = refinement(chain(truth, np.eye(3)))
    poses = bent
    for _ in range(2):
        poses = rounds.round(points_of(scans), poses)
    assert np.all(np.abs(se2.between(truth, poses)) < [0.005, 0.005, 0.003])


def test_a_match_that_was_wrong_does_not_outvote_the_walls():
    """Of scan edges only what keeps the chain together is kept, however sure they were."""
    scans, truth = drive(12)
    edges = chain(truth, 1e6 * np.eye(3))
    edges[5] = Edge("scan", 5, 6, edges[5].i_T_j + np.array([0.08, 0.0, 0.0]), edges[5].information)
    poses = refinement(edges).round(points_of(scans), truth)
    assert np.all(np.abs(se2.between(truth, poses)) < [0.006, 0.006, 0.003])


def test_a_loop_that_the_walls_contradict_moves_nothing_and_a_refused_one_takes_no_part():
    scans, truth = drive(12)
    wrong = se2.between(truth[0], truth[11]) + np.array([0.15, 0.0, 0.0])
    loop = Edge("loop", 0, 11, wrong, 1e4 * np.eye(3))
    refused = Edge("loop", 0, 11, wrong + np.array([3.0, 0.0, 0.0]), 1e8 * np.eye(3), weight=0.0)
    rounds = refinement([*chain(truth, np.eye(3)), loop, refused])
    poses = rounds.round(points_of(scans), truth)
    poses = rounds.round(points_of(scans), poses)
    assert np.all(np.abs(se2.between(truth, poses)) < [0.006, 0.006, 0.003])


@pytest.fixture(scope="module")
def driven():
    scans, truth = drive(25)
    clouds = clouds_of(scans)
    keyframes = [Keyframe(n, clouds[n], truth[n]) for n in (0, 8, 16, 24)]
    return scans, truth, keyframes


def test_scans_between_keyframes_are_placed_and_keyframes_stay(driven):
    scans, truth, keyframes = driven
    index = [k.scan_index for k in keyframes]
    rng = np.random.default_rng(4)
    start = se2.compose(truth, se2.exp(rng.normal(0.0, [0.03, 0.03, 0.01], truth.shape)))
    start[index] = truth[index]
    placed, sigmas = refine.localise_between(scans, np.tile(TWIST, (25, 1)), start, keyframes, Config())
    before, after = (np.abs(se2.between(truth, p)).mean(axis=0) for p in (start, placed))
    assert np.all(after < 0.3 * before)
    assert np.all((sigmas > 0.0) & (sigmas < 0.02))
    np.testing.assert_array_equal(placed[index], truth[index])


def test_a_scan_that_fits_nowhere_stays_where_it_was(driven):
    scans, truth, keyframes = driven
    start = truth.copy()
    start[4] = se2.compose(truth[4], np.array([0.0, 0.8, 0.4]))
    placed, _ = refine.localise_between(scans, np.tile(TWIST, (25, 1)), start, keyframes, Config())
    np.testing.assert_array_equal(placed[4], start[4])
