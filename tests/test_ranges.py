"""Errors of ranges, taken off as the settings tell them."""

from __future__ import annotations

import numpy as np
import pytest

from mfslam.config import SensorConfig
from mfslam.ranges import range_errors_m, with_true_ranges
from mfslam.types import Laser, Scan

SENSOR = SensorConfig(range_error_m=(0.0, 0.02, -0.02), range_error_step_m=0.5)


def scan_of(ranges_m: list[float]) -> Scan:
    count = len(ranges_m)
    laser = Laser("test", np.linspace(-1.0, 1.0, count), np.zeros(count), 0.0, 4.0, 0.02, np.zeros(3))
    return Scan(0, np.array(ranges_m, np.float32), laser)


def test_errors_are_linear_between_their_knots_and_stay_beyond_the_last() -> None:
    found = range_errors_m(SENSOR, np.array([0.0, 0.25, 0.5, 0.75, 1.0, 3.0]))
    assert found == pytest.approx([0.0, 0.01, 0.02, 0.0, -0.02, -0.02])


def test_ranges_are_told_too_large_by_their_error_and_what_is_none_stays() -> None:
    true = with_true_ranges(scan_of([0.5, 2.0, np.inf, np.nan]), SENSOR).ranges_m
    assert true.dtype == np.float32
    assert true[:2] == pytest.approx([0.48, 2.02])
    assert np.isinf(true[2]) and np.isnan(true[3])


def test_without_errors_a_scan_is_left_as_it_is() -> None:
    scan = scan_of([0.5, 2.0])
    assert with_true_ranges(scan, SensorConfig()) is scan
