"""Counts and figures of recorded logs, as their publishers and our own look at them say."""

from __future__ import annotations

import gzip
from itertools import pairwise

import numpy as np
import pytest

from drivers.inspect_log import describe_log
from drivers.logs import default_presets, open_log
from mfslam.settings import load, preset_path
from mfslam.types import Scan, WheelTicks


def config_of(path):
    return load([preset_path(name) for name in default_presets(path)])


@pytest.mark.parametrize(
    ("name", "scans", "odometry", "beams", "distance_m", "duration_s", "backwards", "mount_x_m"),
    [
        ("intel", 13_631, 26_915, 180, 508, 2_691, 631, 0.0),
        ("fr079", 4_934, 8_951, 360, 392, 1_061, 0, -0.04),
        ("mit-killian", 17_480, 0, 180, 1_911, 7_677, 0, 0.0),
    ],
)
def test_carmen(shared_data, name, scans, odometry, beams, distance_m, duration_s, backwards, mount_x_m):
    path = shared_data / "freiburg" / f"{name}.clf.gz"
    told = describe_log(path, config_of(path)).as_json()
    assert told["messages"] == {"Scan": scans} | ({"Odometry": odometry} if odometry else {})
    (laser,) = told["lasers"]
    assert laser["beams"] == beams and laser["first_beam_deg"] == pytest.approx(-90)
    assert laser["mount"] == pytest.approx({"x_m": mount_x_m, "y_m": 0, "yaw_deg": 0}, abs=1e-6)
    assert told["odometry"]["distance_m"] == pytest.approx(distance_m, abs=1)
    assert told["stamps"]["duration_s"] == pytest.approx(duration_s, abs=1)
    assert told["stamps"]["backwards"] == backwards
    assert [f["code"] for f in told["findings"]] == (["stamp-backwards"] if backwards else [])


@pytest.mark.parametrize("name", ["intel", "fr079"])
def test_every_relation_finds_its_scan_by_stamp(shared_data, name):
    path = shared_data / "freiburg" / f"{name}.clf.gz"
    with open_log(path, config_of(path)) as log:
        micros = {m.stamp_ns // 1000 for m in log if isinstance(m, Scan)}
    relations = np.loadtxt(shared_data / "freiburg" / f"{name}.relations", usecols=(0, 1))
    assert len(relations) > 1000
    assert {round(t * 1e6) for t in relations.ravel()} <= micros


@pytest.mark.parametrize(("name", "lines", "duration_s"), [("exp2", 641, 63.2), ("exp3", 525, 51.7)])
def test_urg_text(shared_data, name, lines, duration_s):
    path = shared_data / "urg04lx" / f"{name}.dat.gz"
    with open_log(path, config_of(path)) as log:
        messages = list(log)
    assert [type(m) for m in messages] == [WheelTicks, Scan] * lines
    assert (messages[-1].stamp_ns - messages[0].stamp_ns) * 1e-9 == pytest.approx(duration_s, abs=0.1)
    with gzip.open(path) as file:
        first = file.readline().split()
    ticks, scan = messages[:2]
    assert (ticks.left, ticks.right) == (int(first[2]), int(first[3]))
    told_mm = np.array([int(v) for v in first[24:706]], float)
    sure = (told_mm >= 20) & (told_mm < 4095)
    np.testing.assert_allclose(scan.ranges_m[sure] * 1e3, told_mm[sure], rtol=1e-6)
    assert np.isinf(scan.ranges_m[told_mm >= 4095]).all()
    assert np.isnan(scan.ranges_m[told_mm < 20]).all()
    distance_m = describe_log(path, config_of(path)).odometry["distance_m"]
    assert distance_m == pytest.approx(44, abs=1)


@pytest.mark.parametrize("name", ["exp2", "exp3"])
def test_right_wheel_leads_where_the_scan_turns_left(shared_data, name):
    """A turn to the left carries fixed things to smaller bearings: the scan's shift agrees in sign with
    the right wheel's lead, so the log's first wheel is the left one."""
    path = shared_data / "urg04lx" / f"{name}.dat.gz"
    with open_log(path, config_of(path)) as log:
        messages = list(log)
    ranges = np.nan_to_num(np.array([m.ranges_m for m in messages if isinstance(m, Scan)])[::2])
    lead = np.array([m.right - m.left for m in messages if isinstance(m, WheelTicks)])[::2]
    shifts = range(-60, 61, 2)
    turned = []
    for before, after in pairwise(ranges):
        costs = []
        for shift in shifts:
            a, b = before[100 + shift : 582 + shift], after[100:582]
            both = (a > 0) & (b > 0)
            costs.append(np.minimum(np.abs(a - b)[both], 0.2).mean() if both.sum() > 150 else 1.0)
        turned.append(shifts[int(np.argmin(costs))])
    delayed = np.diff(lead)[:-1]  # scans are some 0.15 s older than their stamps
    assert np.corrcoef(turned[1:], delayed)[0, 1] > 0.2
