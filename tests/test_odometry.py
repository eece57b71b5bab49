"""The wheels' track: poses between its knots, motion over a scan although stamps lie, honest noise."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mfslam import se2
from mfslam.config import OdometryConfig
from mfslam.odometry import OdometryTrack, is_jump, is_plausible, step_sigmas

CONFIG = OdometryConfig()
ARC = np.array([1.2, 0.0, 0.8])


def track_of(times_s, twist=ARC, start_s=0.0):
    track = OdometryTrack()
    for t in times_s:
        track.add(t, se2.exp(twist * (t - start_s)))
    return track


@settings(max_examples=40, deadline=None, derandomize=True)
@given(st.floats(0.0, 2.0), st.integers(2, 30))
def test_between_knots_the_twist_is_held(time_s, knots):
    """Eq. 16 made exact: on a circle, every time is on the circle, however few the knots."""
    track = track_of(np.linspace(0.0, 2.0, knots))
    np.testing.assert_allclose(track.pose_at(time_s), se2.exp(ARC * time_s), atol=1e-12)


def test_the_track_is_held_at_both_ends():
    track = track_of([1.0, 2.0])
    np.testing.assert_array_equal(track.pose_at(-5.0), track.pose_at(1.0))
    np.testing.assert_allclose(track.pose_at(9.0), se2.exp(ARC * 2.0), atol=1e-15)


@settings(max_examples=40, deadline=None, derandomize=True)
@given(st.floats(0.5, 4.5), st.floats(0.0, 0.4))
def test_twist_over_an_interval_is_the_one_that_was_driven(start_s, length_s):
    track = track_of(np.arange(0.0, 5.5, 0.07))
    np.testing.assert_allclose(track.twist_over(start_s, start_s + length_s, CONFIG), ARC, atol=1e-9)


def test_coarse_stamps_are_averaged_over_a_wide_enough_window():
    """Stamps rounded to 50 ms, as hosts do: two knots 10 ms apart would tell five times the speed."""
    track = OdometryTrack()
    for t in np.arange(0.0, 3.0, 0.06):
        track.add(round(t / 0.05) * 0.05, se2.exp(ARC * t))
    for start_s in np.arange(0.5, 2.0, 0.013):
        twist = track.twist_over(start_s, start_s + 0.02, CONFIG)
        np.testing.assert_allclose(twist[[0, 2]], ARC[[0, 2]], rtol=0.35)


def test_stamps_that_go_backwards_widen_the_window():
    """Bursts as in recorded logs: every fourth stamp is 0.2 s early. The pose keeps the log's order."""
    track, true_s = OdometryTrack(), np.arange(0.0, 6.0, 0.1)
    for k, t in enumerate(true_s):
        track.add(t - 0.2 * (k % 4 == 3), se2.exp(ARC * t))
    assert track.backwards_s == pytest.approx(0.1)
    assert np.all(np.diff(track.times_s) >= 0.0)
    for start_s in np.arange(1.0, 5.0, 0.07):
        twist = track.twist_over(start_s, start_s + 0.05, CONFIG)
        assert 0.4 * ARC[0] < twist[0] < 2.0 * ARC[0]


def test_many_knots_at_one_stamp_are_no_division_by_zero():
    track = OdometryTrack()
    for k in range(5):
        track.add(1.0, np.array([0.1 * k, 0.0, 0.0]))
    np.testing.assert_array_equal(track.twist_over(0.9, 1.1, CONFIG), np.zeros(3))
    np.testing.assert_array_equal(track.pose_at(1.0), [0.4, 0.0, 0.0])


def test_too_little_is_no_motion():
    assert len(OdometryTrack()) == 0
    np.testing.assert_array_equal(OdometryTrack().twist_over(0.0, 0.1, CONFIG), np.zeros(3))
    np.testing.assert_array_equal(track_of([0.0]).twist_over(0.0, 0.1, CONFIG), np.zeros(3))
    np.testing.assert_array_equal(track_of([0.0, 1.0]).twist_over(7.0, 7.1, CONFIG), np.zeros(3))


def test_a_jump_of_the_wheels_is_no_motion_to_deskew_with():
    track = OdometryTrack()
    for k in range(30):
        track.add(0.1 * k, np.array([0.1 * k + (3.0 if k >= 15 else 0.0), 0.0, 0.0]))
    for start_s in np.arange(1.0, 2.0, 0.05):  # what was driven beside the jump is told instead
        np.testing.assert_allclose(
            track.twist_over(start_s, start_s + 0.1, CONFIG), [1.0, 0.0, 0.0], atol=1e-9
        )
    assert track.is_broken(1.3, 1.45) and track.is_broken(1.45, 1.6)
    assert not track.is_broken(1.0, 1.4) and not track.is_broken(1.5, 2.0)


def test_a_jump_that_hides_in_the_mean_is_one_all_the_same():
    """0.85 m in one reading of 50 Hz: over 0.3 s a robot could have driven it, over 20 ms none can."""
    track = OdometryTrack()
    for k in range(100):
        track.add(0.02 * k, np.array([0.03 * k + (0.85 if k >= 50 else 0.0), 0.0, 0.0]))
    assert track.is_broken(0.95, 1.05)
    np.testing.assert_allclose(track.twist_over(0.95, 1.05, CONFIG), [1.5, 0.0, 0.0], atol=1e-9)


def test_readings_in_bursts_are_no_jumps():
    """Every five readings arrive at once, 0.3 m after the last burst."""
    track = OdometryTrack()
    for k in range(100):
        track.add(0.2 * (k // 5) + 1e-4 * (k % 5), np.array([0.06 * k, 0.0, 0.0]))
    assert not track.is_broken(0.0, 10.0)


def test_what_wheels_can_do():
    assert is_plausible(np.array([3.0, 0.0, 2.0]), CONFIG)
    assert not is_plausible(np.array([0.0, 0.0, 60.0]), CONFIG)
    assert not is_plausible(np.array([-8.0, 8.0, 0.0]), CONFIG)


def test_noise_grows_with_distance_and_turn():
    still = step_sigmas(np.zeros(3), CONFIG.step_noise)
    np.testing.assert_allclose(still, [CONFIG.sigma_floor_m, CONFIG.sigma_floor_m, CONFIG.sigma_floor_rad])
    metre = step_sigmas(np.array([1.0, 0.0, 0.0]), CONFIG.step_noise)
    np.testing.assert_allclose(metre - still, [0.05, 0.03, 0.03], atol=1e-12)
    quarter = step_sigmas(np.array([0.0, 0.0, -math.pi / 2]), CONFIG.step_noise)
    np.testing.assert_allclose(quarter - still, [0.0, 0.0, 0.08 * math.pi / 2], atol=1e-12)
    np.testing.assert_allclose(step_sigmas(np.array([-1.0, 0.0, 0.0]), CONFIG.step_noise), metre)


def test_a_step_is_a_jump_when_no_robot_drives_so_far():
    assert not is_jump(np.array([0.5, 0.0, 0.3]), 0.1, CONFIG)
    assert is_jump(np.array([10.1, 0.0, 0.0]), 1.0, CONFIG)
    assert is_jump(np.array([0.0, 0.0, -3.1]), 0.1, CONFIG)
    assert not is_jump(np.array([9.9, 0.0, -2.0]), 1.0, CONFIG)
    assert not is_jump(np.array([1.0, 0.0, 0.0]), 0.0, CONFIG), "scans in a burst: their stamps prove nothing"


def test_wheels_that_never_turn_have_not_moved():
    track = OdometryTrack()
    for k in range(5):
        track.add(0.1 * k, np.array([1.0, 2.0, 3.0]))
    assert not track.has_moved
    track.add(0.6, np.array([1.0, 2.01, 3.0]))
    assert track.has_moved
