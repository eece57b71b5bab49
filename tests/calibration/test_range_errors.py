"""Errors of ranges, found by walls that were seen from near and from far."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from drivers.simulator import RobotModel, laser_model, load_world, simulate
from mfslam.calibration.range_errors import RangeErrors, find_range_errors, merged
from mfslam.config import Config, SensorConfig
from mfslam.settings import load, preset_path
from mfslam.slam import Slam, Solution
from mfslam.types import FloatArray, Message, Scan

WAVE_M, LENGTH_M = 0.025, 2.1


def wave_m(ranges_m: FloatArray) -> FloatArray:
    return WAVE_M * np.sin(2.0 * np.pi * ranges_m / LENGTH_M)


@pytest.fixture(scope="module")
def messages() -> list[Message]:
    """Of a simulated URG-04LX, half a minute through an office."""
    simulation = simulate(load_world("office:2:3:1", 1.0), RobotModel(), laser_model("urg-04lx"), seed=1)
    return list(simulation.messages[: len(simulation.messages) // 3])


def mapped(messages: list[Message], amplitude: float) -> tuple[Slam, Solution]:
    """With ranges that are wrong by a wave."""
    slam = Slam(load([preset_path("urg-04lx")]))
    for message in messages:
        if isinstance(message, Scan):
            told = message.ranges_m + amplitude * wave_m(message.ranges_m)
            message = replace(message, ranges_m=told.astype(np.float32))
        slam.feed(message)
    return slam, slam.finish()


def test_a_wave_along_the_range_is_found_but_for_a_straight_line(messages: list[Message]) -> None:
    found = find_range_errors(*mapped(messages, 1.0))
    assert found is not None and found.significant
    at_m = found.step_m * np.arange(len(found.values_m))
    sure = found.sure & (at_m > 0.7)
    assert np.count_nonzero(sure) > 8
    off = (found.values_m - wave_m(at_m))[sure]
    off -= np.polyval(np.polyfit(at_m[sure], off, 1), at_m[sure])
    assert np.abs(off).max() < 0.005


def test_ranges_that_are_right_stay_so(messages: list[Message]) -> None:
    found = find_range_errors(*mapped(messages, 0.0))
    assert found is not None and not found.significant
    assert np.abs(found.values_m[found.sigmas_m < 0.003]).max() < 0.004


def errors(values_m: list[float], sigma_m: float) -> RangeErrors:
    count = len(values_m)
    return RangeErrors(0.5, np.zeros(count), np.array(values_m), np.full(count, sigma_m))


def test_errors_count_where_they_are_sure_and_large() -> None:
    assert errors([0.0, 0.02, 0.02], 0.002).significant
    assert not errors([0.0, 0.02, 0.02], 0.0051).significant
    assert not errors([0.0, 0.009, 0.009], 0.001).significant
    assert not replace(errors([0.0, 0.02, 0.02], 0.002), before_m=np.array([0.0, 0.015, 0.015])).significant


def test_what_is_wrong_at_one_range_alone_is_no_error_of_the_range() -> None:
    assert not errors([0.0, 0.03, 0.0, 0.03], 0.002).significant
    assert not errors([0.0, 0.03, -0.03, 0.0], 0.002).significant


def test_what_a_later_pass_finds_is_seen_from_what_the_first_one_assumed() -> None:
    later = replace(errors([0.0, 0.02, 0.02], 0.002), before_m=np.array([0.0, 0.02, 0.02]))
    assert not later.significant
    assert later.since(SensorConfig()).significant
    assert not later.since(SensorConfig(range_error_m=(0.0, 0.02), range_error_step_m=0.5)).significant


def test_logs_of_one_laser_are_merged_by_their_information() -> None:
    both = merged([errors([0.01, 0.02], 0.001), None, errors([0.02, 0.04, 0.05], 0.002)])
    assert both is not None
    assert both.values_m == pytest.approx([0.012, 0.024, 0.05])
    assert both.sigmas_m == pytest.approx([0.2**0.5 * 0.002, 0.2**0.5 * 0.002, 0.002])
    assert merged([None]) is None


def test_too_few_keyframes_tell_nothing() -> None:
    slam = Slam(Config())
    none = np.zeros((0, 3))
    solution = Solution(
        np.zeros(0, np.int64), none, none, none, np.zeros(0, np.int64), [], np.zeros((0, 3, 3)), none
    )
    assert find_range_errors(slam, solution) is None
