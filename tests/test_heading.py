"""What the gyro tells: turns between any instants, its bias, its gaps; and the compass."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mfslam.config import ImuConfig
from mfslam.heading import HeadingTrack
from mfslam.types import Imu


def track_of(times_s, rate, config=None, yaw=lambda t: None):
    track = HeadingTrack(config or ImuConfig())
    for t in times_s:
        track.add(float(t), Imu(round(t * 1e9), rate(t), yaw(t)))
    return track


@settings(max_examples=40, deadline=None, derandomize=True)
@given(st.floats(0.0, 4.0), st.floats(0.0, 4.0))
def test_the_turn_is_the_integral_of_the_rate(a, b):
    """A rate of cos(t), read at 100 Hz: the turn is sin(b) - sin(a), also between readings."""
    a, b = min(a, b), max(a, b)
    turn = track_of(np.arange(0.0, 4.02, 0.01), math.cos).turn(a, b)
    assert turn == pytest.approx(math.sin(b) - math.sin(a), abs=1e-4)


def test_many_turns_are_counted():
    assert track_of(np.arange(0.0, 60.05, 0.05), lambda t: 2.0).turn(0.0, 60.0) == pytest.approx(120.0)


def test_what_the_gyro_did_not_see_is_not_told():
    track = track_of(np.arange(10.0, 12.0, 0.02), lambda t: 1.0)
    assert track.turn(9.0, 11.0) is None
    assert track.turn(11.0, 13.0) is None
    assert track.turn(10.5, 11.5) == pytest.approx(1.0)
    assert HeadingTrack(ImuConfig()).turn(0.0, 1.0) is None


def test_a_turn_across_a_gap_is_not_told():
    """Silent from 1 s to 2 s: turns on either side are told, none that touches the silence."""
    times = np.concatenate([np.arange(0.0, 1.001, 0.02), np.arange(2.0, 3.0, 0.02)])
    track = track_of(times, lambda t: 0.5)
    assert track.turn(0.2, 0.8) == pytest.approx(0.3)
    assert track.turn(2.2, 2.8) == pytest.approx(0.3)
    for a, b in ((0.5, 2.5), (0.5, 1.9), (1.2, 1.8), (1.5, 2.5)):
        assert track.turn(a, b) is None, (a, b)


def test_stamps_that_do_not_advance_are_passed_over():
    track = track_of([0.0, 0.1, 0.1, 0.05, 0.2, 0.3], lambda t: 1.0)
    assert track.turn(0.0, 0.3) == pytest.approx(0.3)


def test_a_bias_is_learned_and_taken_off():
    """A robot at rest, the gyro says 0.02 rad/s: after a minute of matches turns are zero."""
    track = track_of(np.arange(0.0, 100.0, 0.1), lambda t: 0.02)
    for k in range(90):
        turn = track.turn(float(k), k + 1.0)
        track.learn_bias(1.0, turn, 0.0)
    assert track.bias_rad_s == pytest.approx(0.02, rel=1e-6)
    assert track.turn(10.0, 90.0) == pytest.approx(0.0, abs=1e-6)


def test_a_bias_is_learned_while_turning_and_noise_averages_out():
    rng = np.random.default_rng(2)
    track = track_of(np.arange(0.0, 130.0, 0.1), lambda t: 0.7 - 0.05)
    for k in range(120):
        turn = track.turn(float(k), k + 1.0)
        track.learn_bias(1.0, turn, 0.7 + rng.normal(0.0, 0.01))
    assert track.bias_rad_s == pytest.approx(-0.05, abs=0.005)


def test_a_bias_that_drifts_is_followed():
    track = track_of(np.arange(0.0, 400.0, 0.1), lambda t: 0.0001 * t)
    for k in range(390):
        track.learn_bias(1.0, track.turn(float(k), k + 1.0), 0.0)
    # it lags by no more than the memory of a minute
    assert 0.0001 * 330 < track.bias_rad_s < 0.0001 * 390


def test_a_matched_turn_past_pi_is_the_same_turn():
    track = track_of(np.arange(0.0, 10.0, 0.1), lambda t: math.pi / 2 + 0.01)
    turn = track.turn(0.0, 3.0)  # 3/2 pi and a little; the match says -pi/2
    track.learn_bias(3.0, turn, -math.pi / 2)
    assert track.bias_rad_s == pytest.approx(0.01, rel=1e-6)


def test_no_time_teaches_nothing():
    track = track_of([0.0, 0.1], lambda t: 1.0)
    track.learn_bias(0.0, 1.0, 0.0)
    assert track.bias_rad_s == 0.0


def test_sigma_grows_with_root_of_time_and_then_with_time():
    track = HeadingTrack(ImuConfig(gyro_sigma_rad_per_sqrt_s=0.01, bias_sigma_rad_s=0.001))
    assert track.turn_sigma(0.04) == pytest.approx(0.002, rel=1e-3)
    assert track.turn_sigma(1e4) == pytest.approx(math.hypot(1.0, 10.0))
    assert track.turn_sigma(0.0) > 0.0


def test_a_gyro_that_is_not_wanted_is_silent():
    track = track_of(np.arange(0.0, 5.0, 0.1), lambda t: 1.0, ImuConfig(use_gyro=False))
    assert track.turn(1.0, 2.0) is None


def test_the_compass_counts_from_its_first_heading_and_wraps():
    config = ImuConfig(use_compass=True, compass_sigma_deg=5.0)
    track = track_of([0.0, 0.5, 1.0], lambda t: None, config, yaw=lambda t: 3.0 + t)
    heading, sigma = track.compass(0.95)
    assert heading == pytest.approx(1.0)
    assert sigma == pytest.approx(math.radians(5.0))
    assert track.compass(0.45)[0] == pytest.approx(0.5)
    wrapped = track_of([0.0, 0.5], lambda t: None, config, yaw=lambda t: 3.0 if t == 0.0 else -3.0)
    assert wrapped.compass(0.5)[0] == pytest.approx(2.0 * math.pi - 6.0)


def test_an_old_heading_is_none():
    config = ImuConfig(use_compass=True)
    assert track_of([0.0], lambda t: None, config, yaw=lambda t: 1.0).compass(1.5) is None
    assert track_of([0.0], lambda t: None, ImuConfig(), yaw=lambda t: 1.0).compass(0.0) is None
