"""A smooth trajectory through all scans: speeds and accelerations, instants between scans, what it says of itself."""

from __future__ import annotations

import numpy as np
import pytest

from mfslam import se2
from mfslam.scan_motion import SmoothMotion, smooth

STILL = np.zeros(30, np.bool_)


def driven(rate, times_s: np.ndarray) -> np.ndarray:
    """Poses (S, 3) at instants that are multiples of 1 ms: ``rate`` tells the twist (3,) at any instant."""
    fine = np.arange(0.0, times_s[-1] + 2e-3, 1e-4)
    poses = [np.zeros(3)]
    for twist in rate(fine[:, None] + 0.5e-4):
        poses.append(se2.compose(poses[-1], se2.exp(twist * 1e-4)))
    return np.array(poses)[np.rint(times_s * 1e4).astype(int)]


def speeding_up(t: np.ndarray) -> np.ndarray:
    return np.array([0.5, 0.0, -1.0]) + np.array([1.5, 0.0, 2.0]) * t


def surely(count: int, sigma: float = 1e-4) -> np.ndarray:
    return np.full((count, 3), sigma**2)


def test_a_constant_acceleration_is_found_and_carried_to_instants_between_scans():
    times = np.arange(0.0, 3.0, 0.1)
    truth = driven(speeding_up, np.arange(0.0, 3.0, 0.01))
    motion = smooth(times, truth[::10], surely(30), STILL)
    np.testing.assert_allclose(motion.twists[3:-3, :3], speeding_up(times[3:-3, None]), atol=0.01)
    np.testing.assert_allclose(motion.twists[3:-3, 3:], np.tile([1.5, 0.0, 2.0], (24, 1)), atol=0.1)
    before = motion.relative(np.full(30, -0.05))
    expected = se2.between(truth[::10][1:], truth[5::10][:-1])
    np.testing.assert_allclose(before[1:], expected, atol=2e-4)


def test_a_smooth_trajectory_is_nearer_to_the_truth_and_knows_how_near():
    rng = np.random.default_rng(3)
    times = np.arange(0.0, 60.0, 0.1)
    truth = driven(lambda t: np.sin(t * [1.0, 0.0, 0.7] + [1.5, 0.0, 0.0]) * [1.0, 0.0, 1.5], times)
    noisy = se2.compose(truth, se2.exp(rng.normal(0.0, 0.003, (600, 3))))
    motion = smooth(times, noisy, surely(600, 0.003), np.zeros(600, np.bool_))
    off = se2.log(se2.between(truth, se2.compose(noisy, se2.exp(motion.off))))
    rms = np.sqrt(np.mean(off[5:-5] ** 2, axis=0))
    assert np.all(rms < 0.002)
    assert rms[1] < 0.7 * rms[0]  # it never slips sideways, which is found
    stated = np.sqrt(np.mean(motion.variances_at(np.zeros(600))[5:-5], axis=0))
    np.testing.assert_allclose(stated[[0, 2]], rms[[0, 2]], rtol=0.3)
    between = np.mean(motion.variances_at(np.full(600, 0.05))[5:-5], axis=0)
    assert np.all(between > 0.9 * stated**2)
    assert np.all(between < 2.0 * stated**2)


def test_scans_that_nothing_ties_are_smoothed_apart():
    times = np.arange(0.0, 3.0, 0.1)
    poses = driven(speeding_up, times)
    torn = STILL.copy()
    torn[15] = True
    moved = poses.copy()
    moved[15:] = se2.compose(np.array([7.0, -3.0, 2.0]), poses[15:])
    apart, whole = smooth(times, moved, surely(30), torn), smooth(times, poses, surely(30), torn)
    np.testing.assert_allclose(apart.twists, whole.twists, atol=0.02)
    assert np.abs(apart.off).max() < 1e-3


@pytest.mark.parametrize("count", [1, 2])
def test_one_or_two_scans_have_a_motion_too(count):
    times, poses = np.array([0.0, 0.1])[:count], np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]])[:count]
    motion = smooth(times, poses, surely(count), np.zeros(count, np.bool_))
    assert isinstance(motion, SmoothMotion)
    assert np.isfinite(motion.twists).all()
    assert motion.twists[-1, 0] == pytest.approx(1.0 if count == 2 else 0.0, abs=0.1)


def test_scans_at_one_instant_do_no_harm():
    times = np.repeat(np.arange(0.0, 1.5, 0.1), 2)
    poses = np.column_stack([times, np.zeros((30, 2))])
    motion = smooth(times, poses, surely(30, 0.01), STILL)
    assert motion.twists[10:20, 0] == pytest.approx(np.ones(10), abs=0.05)
    assert np.isfinite(motion.variances_at(np.full(30, -0.02))).all()
