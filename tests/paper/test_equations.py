"""The paper's equations as printed: equal to the exact ones where they may be, and off by what theory says."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from paper import equations as eq
from paper.rig import WHEELS, paper_laser

from mfslam import se2
from mfslam.config import DeskewConfig
from mfslam.deskew import deskew
from mfslam.kernels import align
from mfslam.kinematics import body_twist, move
from mfslam.types import Scan


def test_yaw_rate_of_eq_11_holds_for_slow_turns_only() -> None:
    slow, fast = (body_twist(*eq.wheel_rates(1.0, rate), WHEELS)[2] for rate in (0.01, 2.0))
    assert eq.printed_yaw_rate(-0.005 * 0.33, 0.005 * 0.33, 0.33) == pytest.approx(slow, abs=1e-6)
    assert eq.printed_yaw_rate(-0.33, 0.33, 0.33) == pytest.approx(math.atan(2.0))
    assert fast == pytest.approx(2.0)


def test_the_engine_keeps_eq_11_as_a_named_option() -> None:
    as_printed = WHEELS.model_copy(update={"yaw_rate_rule": "arctangent"})
    left, right = eq.wheel_rates(3.0, 2.0)
    printed = eq.printed_yaw_rate(left * WHEELS.radius_left_m, right * WHEELS.radius_right_m, WHEELS.track_m)
    assert body_twist(left, right, as_printed)[2] == pytest.approx(printed)


def test_step_of_eq_12_holds_straight_on_for_a_cycle_of_one_second() -> None:
    start = np.array([1.0, 2.0, 0.5])
    exact = move(start, np.array([0.7, 0.0, 0.0]), 1.0)
    np.testing.assert_allclose(eq.printed_step(start, 0.7, 0.0, 1.0), exact, atol=1e-12)
    lacking = eq.printed_step(np.zeros(3), 3.0, 0.0, 0.1) - move(np.zeros(3), np.array([3.0, 0.0, 0.0]), 0.1)
    assert lacking[0] == pytest.approx(3.0 * (1.0 - 0.1))


def test_heading_of_the_end_turns_a_step_by_half_its_turn() -> None:
    twist, cycle_s = np.array([3.0, 0.0, 2.0]), 0.1
    off = eq.mended_step(np.zeros(3), 3.0, 2.0, cycle_s) - move(np.zeros(3), twist, cycle_s)
    assert np.hypot(off[0], off[1]) == pytest.approx(0.3 * 0.5 * 0.2, rel=0.01)
    assert off[2] == pytest.approx(0.0)


def test_speed_without_sign_drives_forward_in_reverse() -> None:
    off = eq.mended_step(np.zeros(3), -3.0, 0.0, 0.1) - move(np.zeros(3), np.array([-3.0, 0.0, 0.0]), 0.1)
    assert off[0] == pytest.approx(2 * 0.3)


def test_beam_times_of_eq_15_hold_for_a_scan_that_starts_at_bearing_zero() -> None:
    laser = paper_laser().laser
    from_zero = laser.angles_rad - laser.angles_rad[0]
    np.testing.assert_allclose(eq.printed_beam_times(from_zero, 0.1), laser.offsets_s, atol=1e-12)
    shift_s = eq.printed_beam_times(laser.angles_rad, 0.1) - laser.offsets_s
    np.testing.assert_allclose(shift_s, laser.angles_rad[0] / (2 * math.pi) * 0.1, atol=1e-12)


def test_interpolation_of_eq_16_holds_on_a_straight_and_fails_across_pi() -> None:
    a, b = np.array([0.0, 0.0, 0.3]), se2.compose(np.array([0.0, 0.0, 0.3]), np.array([1.0, 0.0, 0.0]))
    np.testing.assert_allclose(eq.printed_interpolation(a, b, 0.3), se2.interpolate(a, b, 0.3), atol=1e-12)
    before, after = np.array([0.0, 0.0, math.pi - 0.1]), np.array([0.0, 0.0, -math.pi + 0.1])
    assert eq.printed_interpolation(before, after, 0.5)[2] == pytest.approx(0.0)
    assert abs(se2.interpolate(before, after, 0.5)[2]) == pytest.approx(math.pi)


def test_hits_of_eqs_17_and_18_hold_without_a_mount() -> None:
    laser = replace(paper_laser().laser, body_T_laser=np.zeros(3))
    scan = Scan(0, np.full(682, 2.0, dtype=np.float32), laser)
    printed = eq.printed_hits(np.zeros(3), scan.ranges_m.astype(float), laser.angles_rad)
    cloud = deskew(scan, np.zeros(3), DeskewConfig(mode="pose"))
    np.testing.assert_allclose(printed, cloud.points_m, atol=1e-12)


def test_distance_error_of_eq_19_holds_for_a_laser_that_sees_all_around() -> None:
    whole_turn = np.arange(360) / 360 * 0.1  # instants of 360 beams in one turn
    np.testing.assert_allclose(eq.printed_distance_errors(3.0, 0.1, 360), 3.0 * whole_turn)


@pytest.mark.parametrize(("speed_m_s", "sign"), [(3.0, -1.0), (39.9, -1.0), (40.1, 1.0)])
def test_branch_of_eqs_20_to_24_is_at_40_m_s(speed_m_s: float, sign: float) -> None:
    points = eq.printed_compensation(4.0, np.array([0.1, 0.2]), np.array([0.0, 1.0]), speed_m_s, 0.1)
    np.testing.assert_allclose(np.hypot(*points.T), 4.0 + sign * np.array([0.1, 0.2]))


def test_rotation_of_eq_36_is_that_of_the_closed_form_for_spread_points() -> None:
    d = np.random.default_rng(3).uniform(-2.0, 2.0, (50, 2))
    m = se2.transform(np.array([0.2, -0.1, 0.4]), d)
    c, s = math.cos(0.4), math.sin(0.4)
    np.testing.assert_allclose(eq.printed_rotation(d, m), [[c, -s], [s, c]], atol=1e-12)
    np.testing.assert_allclose(align.rigid_fit(d, m), [0.2, -0.1, 0.4], atol=1e-12)


def test_rotation_of_eq_36_mirrors_a_wall_whose_noise_disagrees() -> None:
    along = np.linspace(-1.0, 1.0, 10)
    noise = 0.01 * (-1.0) ** np.arange(10)
    d, m = np.stack([along, noise], axis=-1), np.stack([along, -noise], axis=-1)
    assert np.linalg.det(eq.printed_rotation(d, m)) == pytest.approx(-1.0)
    assert abs(align.rigid_fit(d, m)[2]) < 0.01


def test_translation_of_eq_4_points_backwards() -> None:
    q = np.random.default_rng(4).uniform(-2.0, 2.0, (50, 2))
    m = q + np.array([0.2, -0.1])
    np.testing.assert_allclose(eq.printed_translation(m, q, np.eye(2)), [-0.2, 0.1], atol=1e-12)
    np.testing.assert_allclose(align.rigid_fit(q, m), [0.2, -0.1, 0.0], atol=1e-12)


def test_slips_have_the_sizes_that_theory_gives() -> None:
    sizes = {(slip.number, slip.case): slip.size for slip in eq.slips()}
    by_number = {}
    for (number, _), size in sizes.items():
        by_number.setdefault(number, size)
    laser = paper_laser().laser
    assert by_number["4"] == pytest.approx(2 * 0.2)
    assert by_number["11"] == pytest.approx(math.degrees((2.0 - math.atan(2.0)) * 0.1))
    assert by_number["15"] == pytest.approx(3.0 * 0.1 * -laser.angles_rad[0] / (2 * math.pi))
    assert by_number["17, 18, 41, 42"] == pytest.approx(0.1)
    last_s = 0.5 * float(laser.offsets_s[-1])  # from the middle of the scan
    assert by_number["19-24"] == pytest.approx(
        2 * 3.0 * last_s * math.sin(0.5 * laser.angles_rad[-1]), rel=1e-4
    )
    assert 35.0 < by_number["36"] < 65.0  # a bare wall's noise agrees or disagrees: a coin's toss
