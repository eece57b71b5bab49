"""Eqs. 14 and 15 in closed form."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.beam_timing import ScanTiming, turn_period_s, usual_gap_s
from drivers.laser_models import LogGeometry, clean_ranges, laser_from
from mfslam.config import SensorConfig
from mfslam.settings import load, preset_names, preset_path
from mfslam.types import Findings

STEP = 2 * math.pi / 1024
URG = LogGeometry(682, -340 * STEP, STEP, turn_period_s=0.1)


def sensor(**values: object) -> SensorConfig:
    return SensorConfig.model_validate(values)


def test_beam_angles_are_eq_14():
    j = np.arange(682)
    theta_s, theta_e = -340 * STEP, 341 * STEP
    np.testing.assert_allclose(laser_from(sensor(), URG).angles_rad, theta_s + (theta_e - theta_s) * j / 681)


def test_beam_instants_are_eq_15():
    laser = laser_from(sensor(transport_delay_s=-0.14), URG)
    theta = laser.angles_rad - laser.angles_rad[0]
    np.testing.assert_allclose(laser.offsets_s, theta / (2 * math.pi) * 0.1 - 0.14, atol=1e-15)
    assert np.ptp(laser.offsets_s) == pytest.approx(0.1 * 681 / 1024)  # 66.5 ms of the turn


@pytest.mark.parametrize(
    ("stamp_at", "first", "last"), [("first", 0, 1), ("middle", -0.5, 0.5), ("last", -1, 0)]
)
def test_stamp_belongs_to_the_named_beam(stamp_at, first, last):
    offsets = laser_from(sensor(stamp_at=stamp_at), URG).offsets_s
    duration = 0.1 * 681 / 1024
    assert offsets[[0, -1]] == pytest.approx([first * duration, last * duration])


def test_reversed_beams_are_sensed_last_first():
    plain = laser_from(sensor(), URG)
    turned = laser_from(sensor(reversed_beams=True), URG)
    np.testing.assert_allclose(turned.offsets_s, plain.offsets_s[::-1])
    np.testing.assert_array_equal(turned.angles_rad, plain.angles_rad)


def test_negative_step_keeps_the_order_of_time():
    laser = laser_from(sensor(), LogGeometry(361, math.pi, -math.radians(1), turn_period_s=0.2))
    assert np.all(np.diff(laser.angles_rad) < 0)
    np.testing.assert_allclose(np.diff(laser.offsets_s), 0.2 / 360)


@pytest.mark.parametrize("by", ["setting", "log"])
def test_upside_down_mirrors_bearings_not_time(by):
    plain = laser_from(sensor(), URG)
    told = LogGeometry(682, -340 * STEP, STEP, turn_period_s=0.1, upside_down=by == "log")
    flipped = laser_from(sensor(upside_down=by == "setting"), told)
    np.testing.assert_array_equal(flipped.angles_rad, -plain.angles_rad)
    np.testing.assert_array_equal(flipped.offsets_s, plain.offsets_s)


def test_interlaced_beams_come_a_turn_later():
    laser = laser_from(
        sensor(interlace=2, turn_period_s=0.013), LogGeometry(361, -math.pi / 2, math.radians(0.5))
    )
    j = np.arange(361)
    np.testing.assert_allclose(laser.offsets_s, (j * 0.5 / 360 + j % 2) * 0.013)


def test_setting_wins_over_log_and_zero_period_is_a_snapshot():
    assert np.ptp(laser_from(sensor(turn_period_s=0.2), URG).offsets_s) == pytest.approx(0.2 * 681 / 1024)
    assert not laser_from(sensor(turn_period_s=0.0), URG).offsets_s.any()
    forced = laser_from(sensor(angle_min_deg=-90, angle_step_deg=1.0), URG)
    assert np.degrees(forced.angles_rad[:2]) == pytest.approx([-90, -89])


def test_narrower_range_limits_hold():
    told = LogGeometry(10, 0, 0.1, range_min_m=0.1, range_max_m=8.0)
    laser = laser_from(sensor(range_min_m=0.3, range_max_m=50.0), told)
    assert (laser.range_min_m, laser.range_max_m) == (0.3, 8.0)


def test_mount_each_setting_alone():
    told = LogGeometry(10, 0, 0.1, body_T_laser=(1.0, 2.0, 3.0))
    laser = laser_from(sensor(mount_y_m=0.5, mount_yaw_deg=190.0), told)
    assert laser.body_T_laser == pytest.approx([1.0, 0.5, math.radians(-170)])


def test_clean_ranges():
    laser = laser_from(sensor(range_min_m=0.1, range_max_m=10), LogGeometry(8, 0, 0.1))
    raw = np.array([0.05, 0.1, 5, 10, np.inf, -np.inf, np.nan, 0], dtype=np.float32)
    expected = [np.nan, 0.1, 5, np.inf, np.inf, np.nan, np.nan, np.nan]
    np.testing.assert_allclose(clean_ranges(raw, laser), np.array(expected, dtype=np.float32))


@pytest.mark.parametrize("name", preset_names())
def test_every_preset_makes_a_laser(name):
    laser = laser_from(load([preset_path(name)]).sensor, URG)
    assert np.isfinite(laser.offsets_s).all() and laser.range_min_m < laser.range_max_m
    assert 0 < np.ptp(laser.offsets_s) < 0.2


# --- what a ROS log says of its timing ---


def timing(
    increment_s: float, *, n: int = 361, span_deg: float = 360.0, gap_s: float | None = 0.1
) -> ScanTiming:
    return ScanTiming(n, math.radians(span_deg) / (n - 1), increment_s, gap_s)


@pytest.mark.parametrize(
    ("told", "expected_s"),
    [
        (timing(0.1 / 360), 0.1),  # fits
        (timing(0.075 / 1080, n=1081, span_deg=270), 0.1),  # three quarters of a turn in three of the gap
        (timing(0.1 / 4 / 90, n=91, span_deg=90), 0.1),  # a narrow view explains a short scan
        (timing(1 / 75 / 360, n=181, span_deg=180, gap_s=0.2), 1 / 75),  # a fast mirror on a slow line
    ],
)
def test_plausible_time_increment_is_believed(told, expected_s):
    findings = Findings()
    assert turn_period_s(told, findings) == pytest.approx(expected_s)
    assert len(findings) == 0


@pytest.mark.parametrize("increment_s", [0.0, -1e-4, math.nan, 0.1 / 360 / 20, 153333.0, 0.11 / 360])
def test_implausible_time_increment_is_derived_from_the_gap_and_told(increment_s):
    findings = Findings()
    assert turn_period_s(timing(increment_s), findings) == pytest.approx(0.1)
    assert findings.count("time-increment-repaired") == 1


def test_a_single_scan_tells_no_pace():
    findings = Findings()
    assert turn_period_s(timing(0.0, gap_s=None), findings) == 0.0
    assert "time-increment-unknown" in findings


def test_scan_time_tells_the_turn_where_time_increment_does_not():
    """Every other scan left out on purpose: the scans come more slowly than the laser turns."""
    findings = Findings()
    told = dataclasses.replace(timing(0.0, gap_s=0.2), scan_time_s=0.1)
    assert turn_period_s(told, findings) == pytest.approx(0.1)
    alone = dataclasses.replace(timing(0.0, gap_s=None), scan_time_s=0.1)
    assert turn_period_s(alone, findings) == pytest.approx(0.1)
    assert findings.count("time-increment-repaired") == 2


@pytest.mark.parametrize("scan_time_s", [0.0, math.nan, -0.1, 0.2, 0.01, 100.0])
def test_a_scan_time_that_does_not_fit_the_pace_is_not_believed(scan_time_s):
    told = dataclasses.replace(timing(0.0), scan_time_s=scan_time_s)
    assert turn_period_s(told, Findings()) == pytest.approx(0.1)


@pytest.mark.parametrize("gap_s", [0.001, 30.0])
def test_no_laser_turns_as_fast_or_slowly_as_stamps_may_say(gap_s):
    findings = Findings()
    assert turn_period_s(timing(0.0, gap_s=gap_s), findings) == 0.0
    assert "time-increment-unknown" in findings


@given(st.integers(1, 10), st.integers(120, 300))
def test_the_usual_gap_is_that_of_the_laser_although_scans_come_in_bursts(burst, count):
    """Handed over ``burst`` at a time, 1 ms apart, from a laser of 10 Hz."""
    stamps = [(k - k % burst + burst - 1) * 10**8 + k % burst * 10**6 for k in range(count)]
    assert usual_gap_s(stamps) == pytest.approx(0.1, rel=0.3)


@given(st.floats(-1e4, 1e4), st.integers(1, 299))
def test_the_usual_gap_knows_no_clock_jump_and_no_pause(jump_s, place):
    stamps = [k * 10**8 + (round(jump_s * 1e9) if k >= place else 0) for k in range(300)]
    assert usual_gap_s(stamps) == pytest.approx(0.1)


@pytest.mark.parametrize(("stamps", "gap_s"), [([], None), ([5], None), ([7, 7, 7], None), ([0, 10**8], 0.1)])
def test_few_stamps_tell_what_they_can(stamps, gap_s):
    assert usual_gap_s(stamps) == (None if gap_s is None else pytest.approx(gap_s))
