"""The second pass: which keyframes are matched with which, what a match may change, scans in between."""

from __future__ import annotations

import numpy as np
import pytest

from mfslam import refine, se2
from mfslam.config import Config, RefineConfig
from mfslam.deskew import deskew
from mfslam.frontend import Keyframe
from tests.rooms import ROOM, ROOM_PILLARS, laser, moving_scan

CONFIG = RefineConfig()
TWIST = np.array([0.6, 0.0, 0.5])


def line(count, y=0.0, step_m=0.3):
    return np.stack([step_m * np.arange(count), np.full(count, y), np.zeros(count)], axis=-1)


def test_each_keyframe_is_matched_with_the_ones_before_it():
    pairs = refine.neighbours(line(8, step_m=9.0), CONFIG)
    assert pairs == [(i, j) for j in range(8) for i in range(max(0, j - CONFIG.successive), j)]


def test_another_pass_by_the_same_spot_is_found_once_per_ten_keyframes():
    there, back = line(40), line(40, y=0.5)[::-1]
    pairs = refine.neighbours(np.concatenate([there, back]), CONFIG)
    others = [(i, j) for i, j in pairs if i < j - CONFIG.successive]
    assert others
    poses = np.concatenate([there, back])
    for i, j in others:
        assert np.hypot(*(poses[i] - poses[j])[:2]) <= CONFIG.radius_m
    for j in {j for _, j in others}:
        partners = sorted(i for i, k in others if k == j)
        assert len(partners) <= CONFIG.others
        assert np.all(np.diff(partners) >= 10)
    # half way back the nearest keyframe of the way there is among the partners
    assert (20, 59) in others


def test_those_that_look_the_same_way_come_first():
    poses = np.zeros((60, 3))
    poses[:, 0] = 100.0 * np.arange(1, 61)  # far from each other, but for three
    poses[10], poses[30], poses[59] = (0.0, 0.2, np.pi), (0.0, 0.4, 0.0), (0.0, 0.0, 0.0)
    pairs = refine.neighbours(poses, RefineConfig(others=1))
    assert (30, 59) in pairs and (10, 59) not in pairs


def test_no_others_when_none_are_wanted():
    poses = np.concatenate([line(30), line(30, y=0.2)])
    assert all(j - i <= CONFIG.successive for i, j in refine.neighbours(poses, RefineConfig(others=0)))


def drive(count=25, dt_s=0.1):
    """Scans of a robot on an arc through the room, and its true poses at their stamps."""
    model = laser(turn_s=0.08)
    poses = se2.compose(np.array([-1.5, -0.8, 0.0]), se2.exp(dt_s * np.arange(count)[:, None] * TWIST))
    return [moving_scan(ROOM, ROOM_PILLARS, pose, TWIST, model) for pose in poses], poses


def clouds_of(scans):
    return [deskew(scan, TWIST, Config().deskew, 0.05) for scan in scans]


def test_matches_find_the_truth_from_a_bent_estimate():
    scans, truth = drive(12)
    bent = se2.compose(truth, se2.exp(np.random.default_rng(1).normal(0.0, [0.05, 0.05, 0.02], (12, 3))))
    pairs = refine.neighbours(bent, CONFIG)
    edges = refine.match_neighbours(clouds_of(scans), bent, pairs, 0.01, Config().icp, CONFIG)
    assert len(edges) > 0.9 * len(pairs)
    for edge in edges:
        error = se2.between(se2.between(truth[edge.i], truth[edge.j]), edge.i_T_j)
        assert np.hypot(error[0], error[1]) < 0.01 and abs(error[2]) < 0.005
        assert np.all(np.linalg.eigvalsh(edge.information) > 0.0)


def test_a_match_that_moves_too_far_is_no_match():
    scans, truth = drive(2)
    far = truth.copy()
    far[1] = se2.compose(truth[1], np.array([0.0, 0.45, 0.0]))
    loose = Config(icp={"search_radius_m": 0.6}).icp
    config = RefineConfig(search_radius_m=0.3)
    assert refine.match_neighbours(clouds_of(scans), far, [(0, 1)], 0.01, loose, config) == []


def test_scans_that_share_nothing_are_no_match():
    scans, truth = drive(2)
    other = moving_scan(np.array([[-9.0, 0.7, 9.0, 1.9]]), np.zeros((0, 3)), np.zeros(3), TWIST, laser())
    clouds = clouds_of([scans[0], other])
    assert refine.match_neighbours(clouds, truth, [(0, 1)], 0.01, Config().icp, CONFIG) == []


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
    pairs = refine.neighbours(truth[index], CONFIG)
    placed = refine.localise_between(scans, np.tile(TWIST, (25, 1)), start, keyframes, pairs, Config())
    before, after = (np.abs(se2.between(truth, p)).mean(axis=0) for p in (start, placed))
    assert np.all(after < 0.3 * before)
    np.testing.assert_array_equal(placed[index], truth[index])


def test_a_scan_that_fits_nowhere_stays_where_it_was(driven):
    scans, truth, keyframes = driven
    start = truth.copy()
    start[4] = se2.compose(truth[4], np.array([0.0, 0.8, 0.4]))
    placed = refine.localise_between(scans, np.tile(TWIST, (25, 1)), start, keyframes, [(0, 1)], Config())
    np.testing.assert_array_equal(placed[4], start[4])
