from __future__ import annotations

import math

import pytest
from log_lines import flaser

from drivers.inspect_log import describe_log
from mfslam.settings import load, preset_path

SICK = load([preset_path("sick-lms200")])


def test_figures_of_a_small_log(tmp_path):
    """Ten scans half a metre and a tenth of a radian apart, one jump of 30 m, one stamp back, one twice."""
    stamps = [0.0, 0.2, 0.4, 0.6, 0.6, 0.5, 0.8, 1.0, 1.01, 3.0]
    xs = [0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 33.0, 33.5, 34.0]
    lines = []
    for k, (stamp, x) in enumerate(zip(stamps, xs, strict=True)):
        ranges = [2.0] * 90 + [81.91] * 45 + [0] * 45
        lines.append(flaser(100 + stamp, ranges, (x, 0.0, 0.1 * k)))
    path = tmp_path / "a.clf"
    path.write_text("\n".join(lines) + "\n")
    description = describe_log(path, SICK)
    told = description.as_json()
    assert told["stamps"] == pytest.approx(
        {
            "first_ns": 100 * 10**9,
            "last_ns": 103 * 10**9,
            "duration_s": 3.0,
            "median_gap_s": 0.2,
            "largest_gap_s": 1.99,
            "rate_hz": 5.0,
            "backwards": 1,
            "repeated": 1,
            "bursts": 1,
        }
    )
    assert told["odometry"]["jumps"] == 1
    assert told["odometry"]["distance_m"] == pytest.approx(4.0)
    assert told["odometry"]["turned_deg"] == pytest.approx(math.degrees(0.8))
    assert told["lasers"][0]["no_return_share"] == pytest.approx(0.25)
    assert told["lasers"][0]["invalid_share"] == pytest.approx(0.25)
    text = description.text()
    assert "1 backwards, 1 repeated, 1 in bursts" in text and "4.0 m and 46 deg in all, 1 jumps" in text
    assert "scan stamp is earlier than the one before" in text
