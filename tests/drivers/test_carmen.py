from __future__ import annotations

import bz2
import gzip
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from log_lines import flaser, odom, rawlaser, robotlaser

from drivers.base import Log, NoScans, TopicChoice
from drivers.logs import default_presets, open_log
from mfslam import se2
from mfslam.config import Config, SensorConfig
from mfslam.settings import load, preset_path
from mfslam.types import Message, MfslamError, Odometry, Scan

SICK = load([preset_path("sick-lms200")])
FAR = [5.0] * 180


def read(path: Path, lines: list[str], config: Config = SICK, **options: object) -> tuple[list[Message], Log]:
    path.write_text("\n".join(lines) + "\n")
    with open_log(path, config, **options) as log:  # type: ignore[arg-type]
        return list(log), log


def scans_of(messages: list[Message]) -> list[Scan]:
    return [m for m in messages if isinstance(m, Scan)]


def moving(count: int, **options: object) -> list[str]:
    return [flaser(100.0 + k, FAR, (0.1 * k, 0.0, 0.01 * k), **options) for k in range(count)]  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("count", "first_deg", "last_deg"),
    [(180, -90, 89), (181, -90, 90), (360, -90, 89.5), (361, -90, 90), (541, -135, 135), (401, -50, 50)],
)
def test_field_of_view_follows_from_the_number_of_beams(tmp_path, count, first_deg, last_deg):
    messages, _ = read(tmp_path / "a.log", [flaser(k, [1.0] * count, (k, 0, 0)) for k in (1, 2)])
    angles = np.degrees(scans_of(messages)[0].laser.angles_rad)
    assert angles[0] == pytest.approx(first_deg) and angles[-1] == pytest.approx(last_deg)


def test_unknown_number_of_beams_is_taken_as_half_a_turn_and_said(tmp_path):
    messages, log = read(tmp_path / "a.log", [flaser(k, [1.0] * 203, (k, 0, 0)) for k in (1, 2)])
    assert np.degrees(scans_of(messages)[0].laser.angles_rad[[0, -1]]) == pytest.approx([-90, 90])
    assert log.findings.count("field-of-view-guessed") == 1


def test_mount_is_laser_pose_seen_from_odometry_pose(tmp_path):
    body_T_laser = np.array([-0.04, 0.1, 0.2])
    lines = []
    for k in range(20):
        pose = np.array([0.3 * k, -0.1 * k, 0.4 * k])
        lines.append(
            flaser(k + 1, FAR, se2.wrap(pose) * [0, 0, 1] + pose * [1, 1, 0], se2.compose(pose, body_T_laser))
        )
    messages, log = read(tmp_path / "a.clf", lines)
    assert scans_of(messages)[0].laser.body_T_laser == pytest.approx(body_T_laser, abs=2e-6)
    assert len(log.findings) == 0


def test_set_mount_wins_over_the_log(tmp_path):
    lines = moving(3, laser=(9.0, 9.0, 9.0))
    config = SICK.model_copy(update={"sensor": SICK.sensor.model_copy(update={"mount_x_m": 0.25})})
    messages, _ = read(tmp_path / "a.clf", ["PARAM robot_frontlaser_offset 0.1 1 h 1", *lines], config)
    assert scans_of(messages)[0].laser.body_T_laser == pytest.approx([0.25, 0, 0])


def test_corrected_log_takes_its_mount_from_param_and_says_so(tmp_path):
    """In corrected logs the 'laser pose' is a corrected pose of the robot, which drifts off the odometry."""
    lines = [flaser(k + 1, FAR, (0.5 * k, 0, 0), (0.5 * k, 0.1 * k, 0.02 * k)) for k in range(30)]
    messages, log = read(tmp_path / "a.clf", ["PARAM robot_frontlaser_offset 0.1 1 h 1", *lines])
    assert scans_of(messages)[0].laser.body_T_laser == pytest.approx([0.1, 0, 0])
    assert log.findings.count("mount-unclear") > 20


def test_param_may_shorten_the_range(tmp_path):
    line = flaser(1, [1.0, 7.9, 8.0, 50.0, 81.83] * 36, (0, 0, 0))
    messages, _ = read(tmp_path / "a.clf", ["PARAM robot_front_laser_max 8.0 1 h 1", line])
    assert np.isposinf(scans_of(messages)[0].ranges_m[:5]).tolist() == [False, False, True, True, True]


def test_ranges_no_return_and_nonsense(tmp_path):
    values = ["1.25", "0", "-3", "nan", "inf", "-inf", "50.0", "51.15", "81.91", "49.99"] * 18
    messages, log = read(tmp_path / "a.clf", [flaser(1, values, (0, 0, 0))])
    got = scans_of(messages)[0].ranges_m[:10]
    expected = [1.25, np.nan, np.nan, np.nan, np.inf, np.nan, np.inf, np.inf, np.inf, 49.99]
    np.testing.assert_allclose(got, np.array(expected, dtype=np.float32))
    assert log.findings.count("range-invalid") == 3 * 18  # -3, nan, -inf; zero is an ordinary code


def test_stamps_are_exact_and_the_first_of_the_two(tmp_path):
    messages, _ = read(
        tmp_path / "a.clf", [flaser(1031745824.658001, FAR, (0, 0, 0)), odom(976052857.337531, (1, 2, 3))]
    )
    assert [m.stamp_ns for m in messages] == [1031745824658001000, 976052857337531000]
    assert isinstance(messages[1], Odometry) and messages[1].odom_T_body == pytest.approx([1, 2, 3])


def test_scan_carries_the_odometry_pose_of_its_line(tmp_path):
    messages, log = read(
        tmp_path / "a.clf", [flaser(1, FAR, (1, 2, 0.5)), flaser(2, FAR, (math.nan, 2, 0.5))]
    )
    first, second = scans_of(messages)
    assert first.odom_T_body == pytest.approx([1, 2, 0.5])
    assert second.odom_T_body is None and log.findings.count("odometry-invalid") == 1


def test_backward_and_repeated_stamps_are_kept_in_order_and_counted(tmp_path):
    lines = [flaser(s, FAR, (s, 0, 0)) for s in (5, 6, 6, 4, 7)]
    messages, log = read(tmp_path / "a.clf", lines)
    assert [m.stamp_ns // 10**9 for m in messages] == [5, 6, 6, 4, 7]
    assert log.findings.count("stamp-backwards") == 1 and log.findings.count("stamp-repeated") == 1


def test_change_of_beam_count_makes_a_new_laser(tmp_path):
    counts = (180, 361, 361, 180)
    messages, log = read(
        tmp_path / "a.clf", [flaser(k, [2.0] * n, (k, 0, 0)) for k, n in enumerate(counts, 1)]
    )
    lasers = [s.laser for s in scans_of(messages)]
    assert [laser.angles_rad.size for laser in lasers] == list(counts)
    assert lasers[0] is lasers[3] and lasers[1] is lasers[2]
    assert log.findings.count("laser-changed") == 2


def test_half_degree_scans_of_a_sick_are_interlaced_unless_told_otherwise(tmp_path):
    lines = [flaser(1, [2.0] * 361, (0, 0, 0))]
    messages, _ = read(tmp_path / "a.clf", lines)
    offsets = scans_of(messages)[0].laser.offsets_s
    turn = SICK.sensor.turn_period_s
    assert turn is not None
    since_first = offsets - offsets[0]
    assert since_first[[1, 2]] == pytest.approx([turn * (1 + 0.5 / 360), turn / 360])
    plain = load([preset_path("sick-lms200")], ["sensor.interlace=1"])
    messages, _ = read(tmp_path / "b.clf", lines, plain)
    assert np.diff(scans_of(messages)[0].laser.offsets_s) == pytest.approx(turn * 0.5 / 360)


def test_robotlaser_tells_its_geometry(tmp_path):
    geometry = "5 -0.5 1.0 0.01 12.0 0.01 0"
    lines = [
        robotlaser(k, [1.0, 12.0, *[3.0] * 99], (k, 0, 0), (k + 0.3, 0, 0), geometry=geometry, remissions=3)
        for k in (1, 2, 3)
    ]
    messages, log = read(tmp_path / "a.clf", lines)
    scan = scans_of(messages)[1]
    np.testing.assert_allclose(scan.laser.angles_rad, -0.5 + 0.01 * np.arange(101))
    assert scan.laser.range_max_m == 12.0 and np.isposinf(scan.ranges_m[1])
    assert scan.laser.body_T_laser == pytest.approx([0.3, 0, 0]) and scan.odom_T_body == pytest.approx(
        [2, 0, 0]
    )
    assert len(log.findings) == 0


def test_rawlaser_with_odometry_lines(tmp_path):
    lines = [line for k in range(4) for line in (odom(k + 1, (k, 0, 0)), rawlaser(k + 1.5, FAR))]
    messages, log = read(tmp_path / "a.clf", lines)
    assert [type(m) for m in messages] == [Odometry, Scan] * 4
    assert all(s.odom_T_body is None for s in scans_of(messages))
    assert log.info.details["odometry"] == "moving"


def test_two_lasers_front_by_default_rear_by_name(tmp_path):
    lines = []
    for k in range(5):
        lines += [
            flaser(k + 1, FAR, (k, 0, 0)),
            flaser(k + 1.1, [3.0] * 180, (k, 0, 0), (k - 0.3, 0, math.pi), "RLASER"),
        ]
    messages, log = read(tmp_path / "a.clf", lines)
    assert len(messages) == 5 and "several-lasers" in log.findings
    assert "FLASER (5), RLASER (5); FLASER is used" in log.findings.lines()[0]
    messages, _ = read(tmp_path / "a.clf", lines, topics=TopicChoice(scan="rlaser"))
    rear = scans_of(messages)[0].laser.body_T_laser
    assert rear[0] == pytest.approx(-0.3) and abs(rear[2]) == pytest.approx(math.pi)
    with pytest.raises(
        MfslamError, match=r"no scans named 'RAWLASER1' in it; there are: FLASER \(5\), RLASER \(5\)"
    ):
        read(tmp_path / "a.clf", lines, topics=TopicChoice(scan="RAWLASER1"))


def test_odometry_that_never_moves_is_noticed(tmp_path):
    _, log = read(tmp_path / "a.clf", [flaser(k, FAR, (1, 2, 3)) for k in range(1, 5)])
    assert log.info.details["odometry"] == "constant" and "no-odometry" in log.findings


def test_cut_and_garbled_lines_are_counted_with_their_line(tmp_path):
    good = moving(3)
    lines = [
        good[0],
        good[1][:300],
        good[1],
        "FLASER",
        "FLASER x y",
        "2.31 2.31 2.36",
        odom(3, (1, 2, 3))[:30],
        good[2],
    ]
    messages, log = read(tmp_path / "a.clf", lines)
    assert len(scans_of(messages)) == 3 and len(messages) == 3
    assert log.findings.count("line-garbled") == 4 and log.findings.count("unknown-line") == 1
    assert dict(log.findings)["line-garbled"].first_where == "a.clf:2"


@pytest.mark.parametrize("keep", [0.3, 0.9])
def test_cut_gzip_gives_what_is_there(tmp_path, keep):
    rng = np.random.default_rng(1)
    text = "\n".join(flaser(k, rng.uniform(1, 9, 180).round(2), (k, 0, 0)) for k in range(1, 400)).encode()
    data = gzip.compress(text)
    path = tmp_path / "a.clf.gz"
    path.write_bytes(data[: int(len(data) * keep)])
    with open_log(path, SICK) as log:
        scans = scans_of(list(log))
    assert abs(len(scans) - keep * 399) < 15
    assert "file-damaged" in log.findings


def test_damaged_gzip_is_told(tmp_path):
    text = "\n".join(moving(50)).encode()
    data = bytearray(gzip.compress(text))
    data[len(data) // 2] ^= 0xFF
    path = tmp_path / "a.clf.gz"
    path.write_bytes(data)
    try:
        with open_log(path, SICK) as log:
            list(log)
        assert "file-damaged" in log.findings
    except MfslamError as error:
        assert "damaged" in str(error) or "no scans" in str(error)


@pytest.mark.parametrize("pack", [bytes, gzip.compress, bz2.compress])
def test_compression_is_told_by_content(tmp_path, pack):
    path = tmp_path / "some.log"
    path.write_bytes(pack(("\n".join(moving(4)) + "\n").encode()))
    with open_log(path, SICK) as log:
        assert len(list(log)) == 4
        assert log.progress() == 1.0


def test_log_without_scans_names_what_it_holds(tmp_path):
    with pytest.raises(NoScans, match=r"no scans in it .*it holds ODOM \(2\)"):
        read(tmp_path / "a.clf", [odom(1, (0, 0, 0)), odom(2, (1, 0, 0))])
    with pytest.raises(NoScans, match="none of its FLASER lines is complete"):
        read(tmp_path / "a.clf", ["FLASER 180 1 2 3"])


def test_default_preset_follows_the_laser(tmp_path):
    def preset(line: str) -> list[str]:
        (tmp_path / "a.clf").write_text(line + "\n")
        return default_presets(tmp_path / "a.clf")

    assert preset(moving(1)[0]) == ["sick-lms200"]
    assert preset(flaser(1, [1.0] * 682, (0, 0, 0))) == ["urg-04lx"]
    assert preset(flaser(1, [1.0] * 1081, (0, 0, 0))) == ["utm-30lx"]
    assert preset(
        robotlaser(1, [1.0] * 300, (0, 0, 0), (0, 0, 0), geometry="9 -2.35 4.71 0.0157 10 0 0")
    ) == ["generic"]


def test_unknown_turn_period_is_told(tmp_path):
    messages, log = read(tmp_path / "a.clf", moving(2), Config(sensor=SensorConfig()))
    assert not scans_of(messages)[0].laser.offsets_s.any()
    assert "turn-period-unknown" in log.findings


ranges = st.floats(0.03125, 49.5, width=32)
poses = st.tuples(*[st.floats(-1e4, 1e4)] * 2, st.floats(-3.14, 3.14))
QUICK = settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


@QUICK
@given(values=st.lists(ranges, min_size=2, max_size=400), pose=poses, stamp_us=st.integers(0, 2 * 10**15))
def test_round_trip(tmp_path, values, pose, stamp_us):
    line = flaser(0, values, pose)
    whole, micro = divmod(stamp_us, 10**6)
    fields = line.split()
    fields[-3] = f"{whole}.{micro:06d}"
    messages, _ = read(tmp_path / "a.clf", [" ".join(fields)])
    scan = scans_of(messages)[0]
    assert scan.stamp_ns == stamp_us * 1000
    assert scan.ranges_m.tolist() == np.array(values, dtype=np.float32).tolist()
    assert scan.odom_T_body == pytest.approx(pose, abs=1e-6)


@QUICK
@given(data=st.data())
def test_mangled_lines_never_crash_and_are_always_accounted_for(tmp_path, data):
    good = [flaser(k, [2.0, 3.0, 4.0], (k, 0, 0)) for k in range(1, 5)] + [odom(9, (1, 2, 3))]
    mangled = []
    for line in good:
        start = data.draw(st.integers(0, len(line)))
        end = data.draw(st.integers(start, len(line)))
        junk = data.draw(st.binary(max_size=12).map(lambda b: b.replace(b"\n", b"?").replace(b"\x00", b"?")))
        raw = line.encode()
        mangled.append(raw[:start] + junk + raw[end:])
    anchor = flaser(20, [1.0] * 180, (5, 5, 1)).encode()
    path = tmp_path / "a.clf"
    path.write_bytes(b"\n".join([anchor, *mangled, anchor]) + b"\n")
    with open_log(path, SICK) as log:
        messages = list(log)
    assert isinstance(messages[0], Scan) and isinstance(messages[-1], Scan)
    lines = [line.split() for line in path.read_bytes().split(b"\n")]
    blank = sum(1 for fields in lines if not fields or fields[0].startswith(b"#"))
    lost = log.findings.count("line-garbled") + log.findings.count("unknown-line")
    other = sum(n for word, n in log.info.details["messages"].items() if word not in ("FLASER", "ODOM"))
    assert len(messages) + lost + blank + other == len(lines)
