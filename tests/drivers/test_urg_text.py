from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from log_lines import urg

from drivers.base import NoScans, TopicChoice
from drivers.logs import default_presets, open_log
from mfslam.settings import load, preset_path
from mfslam.types import MfslamError, Scan, WheelTicks

ROBOT = load([preset_path(name) for name in ("urg-04lx", "urg-text-robot")])
WALL = [1500] * 682
QUICK = settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def read(path, lines, config=ROBOT):
    path.write_text("\n".join(lines) + "\n")
    with open_log(path, config) as log:
        return list(log), log


def test_ticks_and_scan_share_a_stamp_ticks_first(tmp_path):
    messages, log = read(tmp_path / "a.dat", [urg(361431443, 10, 20, WALL), urg(361528520, 30, 40, WALL)])
    assert [type(m) for m in messages] == [WheelTicks, Scan] * 2
    assert [m.stamp_ns for m in messages] == [361431443000] * 2 + [361528520000] * 2
    assert messages[2] == WheelTicks(361528520000, 30, 40)
    assert messages[1].laser is messages[3].laser and len(log.findings) == 0


def test_error_codes_say_nothing(tmp_path):
    values = [0, 1, 7, 19, 20, 21, 4000, 4094, 4095, *[1000] * 673]
    messages, _ = read(tmp_path / "a.dat", [urg(1, 0, 0, values)])
    got = messages[1].ranges_m[:9]
    expected = [np.nan] * 4 + [0.02, 0.021, 4.0, 4.094, np.inf]
    np.testing.assert_allclose(got, expected, rtol=1e-6)


def test_beams_and_timing_of_the_urg(tmp_path):
    messages, _ = read(tmp_path / "a.dat", [urg(1, 0, 0, WALL)])
    laser = messages[1].laser
    assert np.degrees(laser.angles_rad[[0, 340, 681]]) == pytest.approx([-119.53125, 0.0, 119.8828125])
    assert laser.offsets_s[[0, 681]] == pytest.approx([-0.18, -0.18 + 681 / 1024 * 0.1])
    assert laser.body_T_laser == pytest.approx([0.145, 0, 0])


def test_swapped_sides(tmp_path):
    config = load([preset_path("urg-04lx")], ["wheels.swap_sides=true"])
    messages, _ = read(tmp_path / "a.dat", [urg(1, 10, 20, WALL)], config)
    assert messages[0] == WheelTicks(1000, 20, 10)


def test_cut_lines_are_counted(tmp_path):
    good = urg(5, 1, 2, WALL)
    messages, log = read(tmp_path / "a.dat", [good, good[:2000], good.replace("1 2 ", "1 x ", 1), good[:-20]])
    assert len(messages) == 2
    assert log.findings.count("line-garbled") == 3


def test_nothing_usable(tmp_path):
    bad = urg(5, "x", 2, WALL)
    with pytest.raises(NoScans, match="no line has 706 readable fields"):
        read(tmp_path / "a.dat", [bad])
    (tmp_path / "b.dat").write_text(urg(5, 1, 2, WALL))
    with pytest.raises(MfslamError, match="nothing to choose by name"):
        open_log(tmp_path / "b.dat", ROBOT, topics=TopicChoice(scan="/scan"))
    assert default_presets(tmp_path / "b.dat") == ["urg-04lx", "urg-text-robot"]


@QUICK
@given(
    st.integers(0, 2**52),
    st.integers(-(2**40), 2**40),
    st.integers(-(2**40), 2**40),
    st.lists(st.integers(20, 4094), min_size=682, max_size=682),
)
def test_round_trip(tmp_path, stamp_us, left, right, ranges_mm):
    (ticks, scan), _ = read(tmp_path / "a.dat", [urg(stamp_us, left, right, ranges_mm)])
    assert ticks == WheelTicks(stamp_us * 1000, left, right)
    np.testing.assert_allclose(scan.ranges_m * 1e3, ranges_mm, rtol=1e-6)


@QUICK
@given(st.data())
def test_mangled_lines_never_crash_and_are_always_counted(tmp_path, data):
    good = urg(5, 1, 2, WALL)
    cut = data.draw(st.integers(1, len(good) - 1))
    junk = data.draw(st.text(st.characters(min_codepoint=33, max_codepoint=126), min_size=1, max_size=8))
    end = data.draw(st.integers(cut, len(good)))
    messages, log = read(tmp_path / "a.dat", [good, "7" + good[1:cut] + junk + good[end:], good])
    assert len(messages) in (4, 6)
    assert log.findings.count("line-garbled") == (6 - len(messages)) // 2
