"""Systematic errors of the wheels are learned from matched steps, and no more is believed than they show."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mfslam import se2
from mfslam.config import OdometryConfig
from mfslam.odometry import step_sigmas
from mfslam.wheel_errors import WheelErrors, WheelStep

CONFIG = OdometryConfig()
SURE = np.diag([0.003**-2, 0.003**-2, 0.001**-2])  # of a match in a room
CORRIDOR = np.diag([0.0, 0.003**-2, 0.001**-2])


def drive(errors, scale=0.0, drift=0.0, turn_scale=0.0, steps=400, noise=0.0, information=SURE, seed=0):
    """Steps of 0.2 m and turns both ways; the truth is what differential wheels so wrong would hide."""
    rng = np.random.default_rng(seed)
    for k in range(steps):
        told = np.array([0.2, 0.0, 0.15 * np.sin(0.3 * k)])
        truth = se2.exp(
            np.array([(1.0 + scale) * told[0], 0.0, (1.0 + turn_scale) * told[2] + drift * told[0]])
        )
        told = se2.exp(told)
        errors.learn(WheelStep(told + noise * rng.standard_normal(3), truth, information))


@pytest.mark.parametrize(
    ("scale", "drift", "turn_scale"),
    [(0.03, 0.0, 0.0), (0.0, -0.02, 0.0), (0.0, 0.0, 0.08), (-0.02, 0.05, -0.05)],
)
def test_what_is_wrong_with_the_wheels_is_learned(scale, drift, turn_scale):
    errors = WheelErrors(CONFIG)
    drive(errors, scale, drift, turn_scale)
    np.testing.assert_array_less(np.abs(errors.errors - [scale, turn_scale, drift]), [1e-3, 4e-3, 1e-3])


def test_a_corrected_step_is_the_true_one():
    errors = WheelErrors(CONFIG)
    drive(errors, 0.02, 0.03, -0.04)
    told = np.array([0.3, 0.0, 0.1])
    truth = se2.exp(np.array([1.02 * 0.3, 0.0, 0.96 * 0.1 + 0.03 * 0.3]))
    np.testing.assert_allclose(errors.corrected(se2.exp(told)), truth, atol=1e-3)


@given(
    st.tuples(st.floats(-0.5, 0.5), st.floats(-0.1, 0.1), st.floats(-1.0, 1.0)),
    st.tuples(st.floats(-0.1, 0.1), st.floats(-0.2, 0.2), st.floats(-0.1, 0.1)),
)
def test_told_undoes_corrected(step, wrong):
    errors = WheelErrors(CONFIG)
    errors.found(np.array(wrong), np.ones(3))
    step = np.array(step)
    np.testing.assert_allclose(errors.told(errors.corrected(step)), step, atol=1e-9)


def test_matches_that_slide_along_a_corridor_tell_nothing_of_the_scale():
    errors = WheelErrors(CONFIG)
    drive(errors, scale=0.03, drift=0.02, information=CORRIDOR)
    assert errors.errors[0] == 0.0
    assert errors.errors[2] == pytest.approx(0.02, abs=1e-3)
    assert errors.noise_share[0] == 1.0


def test_no_more_is_learned_than_was_thought_possible():
    """Two steps are no proof that wheels are wrong by a third."""
    errors = WheelErrors(CONFIG)
    unsure = np.diag([0.2**-2, 0.2**-2, 0.2**-2])
    drive(errors, scale=0.3, drift=0.3, steps=10, information=unsure)
    assert np.all(np.abs(errors.errors[[0, 2]]) < 0.05)


def test_better_wheels_than_configured_become_surer_factors_and_worse_ones_less():
    good, bad = WheelErrors(CONFIG), WheelErrors(CONFIG)
    drive(good, drift=0.01)
    drive(bad, noise=0.1)
    step = WheelStep(np.array([0.2, 0.0, 0.0]), good.corrected(np.array([0.2, 0.0, 0.0])), SURE)
    configured = CONFIG.white_share * step_sigmas(step.told, CONFIG.step_noise) ** -2
    assert np.all(np.diag(good.factors([step])[1][0]) > 5.0 * configured)
    clean = WheelStep(step.told, bad.corrected(step.told), SURE)
    assert np.all(np.diag(bad.factors([clean])[1][0]) < 0.5 * configured)


def test_a_step_that_the_scans_contradict_weighs_no_more_than_the_contradiction():
    errors = WheelErrors(CONFIG)
    drive(errors)
    slipped = WheelStep(np.array([0.2, 0.0, 0.0]), np.array([0.05, 0.0, 0.0]), SURE)
    (information,) = errors.factors([slipped])[1]
    assert information[0, 0] == pytest.approx(0.15**-2, rel=0.05)
    assert information[2, 2] > 1e3


def test_learning_can_be_turned_off_and_a_gap_begins_a_new_measurement():
    off = WheelErrors(OdometryConfig(learn_errors=False))
    drive(off, scale=0.05)
    assert off.errors[0] == 0.0
    broken = WheelErrors(CONFIG)
    for _ in range(50):  # never a whole metre in one piece
        drive(broken, scale=0.05, steps=4)
        broken.skip()
    assert broken.errors[0] == 0.0


def test_what_is_known_of_the_noise_and_a_jump_stand_in_the_factor():
    errors, told = WheelErrors(CONFIG), np.array([0.3, 0.0, 0.1])
    fits = WheelStep(told, told, SURE)
    jumps = WheelStep(told, told, SURE, jumped=True)
    steps, (information, distrusted) = errors.factors([fits, jumps])
    np.testing.assert_allclose(steps, [told, told], atol=1e-15)
    sigmas = np.sqrt(CONFIG.white_share / np.diag(information))
    np.testing.assert_allclose(sigmas, step_sigmas(told, CONFIG.step_noise), rtol=1e-12)
    np.testing.assert_allclose(distrusted, 1e-4 * information)
