from __future__ import annotations

import math
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ros_bags import TF, Entry, Make, write_bag

from drivers.base import Log, NoScans, TopicChoice
from drivers.logs import detect, open_log
from drivers.ros_transforms import heading, rotation, yaw_of
from mfslam.config import Config
from mfslam.settings import load
from mfslam.types import Imu, Message, MfslamError, Odometry, Scan, WheelAngles

SCAN, ODOM, IMU, JOINTS = (
    "sensor_msgs/msg/LaserScan",
    "nav_msgs/msg/Odometry",
    "sensor_msgs/msg/Imu",
    "sensor_msgs/msg/JointState",
)
T0, GAP = 1_700_000_000_000_000_000, 100_000_000
MAKE = Make()


def wall(seed: int = 0) -> list[float]:
    return np.random.default_rng(seed).uniform(1, 9, 360).astype(np.float32).tolist()


def scans(count: int, make: Make = MAKE, topic: str = "/scan", **values: Any) -> list[Entry]:
    return [
        (topic, SCAN, make.scan(T0 + k * GAP, wall(k), **values), T0 + k * GAP + 5_000_000)
        for k in range(count)
    ]


def odometry(count: int, make: Make = MAKE, topic: str = "/odom") -> list[Entry]:
    return [
        (topic, ODOM, make.odometry(T0 + k * GAP, 0.1 * k, 0.0, 0.01 * k), T0 + k * GAP) for k in range(count)
    ]


def mount(make: Make = MAKE) -> Entry:
    return (
        "/tf_static",
        TF,
        make.transform("base_link", "laser", (0.2, 0.1, 0.3), make.quaternion(yaw=0.5)),
        T0,
    )


def read(
    tmp_path: Path, entries: list[Entry], config: Config | None = None, kind: str = "mcap", **options: Any
) -> tuple[list[Message], Log]:
    path = tmp_path / ("log.bag" if kind == "ros1" else "log")
    if path.is_dir():
        shutil.rmtree(path)
    write_bag(path, kind, sorted(entries, key=lambda e: e[3]))
    with open_log(path, config or Config(), **options) as log:
        return list(log), log


def only_scans(messages: list[Message]) -> list[Scan]:
    return [m for m in messages if isinstance(m, Scan)]


@pytest.mark.parametrize("kind", ["ros1", "sqlite3", "mcap"])
def test_every_kind_of_bag_says_the_same(tmp_path, kind):
    make = Make("ros1" if kind == "ros1" else "ros2")
    messages, log = read(tmp_path, [mount(make), *scans(5, make), *odometry(5, make)], kind=kind)
    assert [type(m) for m in messages] == [Odometry, Scan] * 5
    first = messages[1]
    assert isinstance(first, Scan) and first.stamp_ns == T0
    np.testing.assert_array_equal(first.ranges_m, np.array(wall(0), np.float32))
    assert first.laser.body_T_laser == pytest.approx([0.2, 0.1, 0.5])
    assert np.diff(first.laser.offsets_s) == pytest.approx(0.1 / 360)
    assert len({id(s.laser) for s in only_scans(messages)}) == 1
    odom = messages[8]
    assert isinstance(odom, Odometry) and odom.odom_T_body == pytest.approx([0.4, 0, 0.04])
    assert log.findings.lines() == [] and log.progress() == 1.0
    assert log.info.format == ("ros1" if kind == "ros1" else "ros2")
    assert log.info.details["messages"] == {"/odom": 5, "/scan": 5, "/tf_static": 1}


@pytest.mark.parametrize("kind", ["sqlite3", "mcap"])
def test_bare_file_and_folder_without_metadata(tmp_path, kind):
    write_bag(tmp_path / "log", kind, [mount(), *scans(4)])
    (bare,) = [p for p in (tmp_path / "log").iterdir() if p.suffix in (".db3", ".mcap")]
    renamed = tmp_path / "renamed.dat"
    shutil.copy(bare, renamed)
    (tmp_path / "log" / "metadata.yaml").unlink()
    for path in (bare, renamed, tmp_path / "log"):
        assert detect(path) == "ros2"
        with open_log(path, Config()) as log:
            assert len(only_scans(list(log))) == 4
    assert "no-metadata" in log.findings


def test_ros1_bag_of_another_name(tmp_path):
    path = write_bag(tmp_path / "a.bag", "ros1", scans(3, Make("ros1")))
    path = path.rename(tmp_path / "a.log")
    with open_log(path, Config()) as log:
        assert len(only_scans(list(log))) == 3


def test_first_echo_of_a_multi_echo_scan(tmp_path):
    entries = [
        (
            "/echo",
            "sensor_msgs/msg/MultiEchoLaserScan",
            MAKE.multi_echo(T0 + k * GAP, [[2, 5], [], [3]]),
            T0 + k * GAP,
        )
        for k in range(3)
    ]
    messages, _ = read(tmp_path, entries)
    np.testing.assert_array_equal(only_scans(messages)[0].ranges_m, [2, np.nan, 3])


@pytest.mark.parametrize("increment_s", [0.0, 0.1 / 360 / 20])
def test_bad_time_increment_is_derived_and_reported(tmp_path, increment_s):
    messages, log = read(tmp_path, scans(5, time_increment=increment_s))
    assert np.ptp(only_scans(messages)[0].laser.offsets_s) == pytest.approx(0.1 * 359 / 360)
    assert log.findings.count("time-increment-repaired") == 1


def test_turn_period_setting_wins(tmp_path):
    messages, log = read(
        tmp_path, [mount(), *scans(3, time_increment=0.0)], load([], ["sensor.turn_period_s=0"])
    )
    assert not only_scans(messages)[0].laser.offsets_s.any()
    assert "time-increment-repaired" not in log.findings


def test_clockwise_beams(tmp_path):
    values = {"angle_min": math.pi, "angle_max": -math.pi, "angle_increment": -2 * math.pi / 360}
    messages, _ = read(tmp_path, scans(3, **values))
    laser = only_scans(messages)[0].laser
    assert np.all(np.diff(laser.angles_rad) < 0) and np.all(np.diff(laser.offsets_s) > 0)


def test_empty_angle_increment_follows_from_the_ends(tmp_path):
    messages, _ = read(tmp_path, scans(3, angle_min=-1.0, angle_max=1.0, angle_increment=0.0))
    np.testing.assert_allclose(only_scans(messages)[0].laser.angles_rad, np.linspace(-1, 1, 360), atol=1e-6)


def test_mount_through_a_chain_from_the_odometry_child_frame(tmp_path):
    entries = [
        ("/tf_static", TF, MAKE.transform("base_footprint", "base_link", (0, 0, 0.1)), T0),
        (
            "/tf_static",
            TF,
            MAKE.transform("base_link", "mast", (0.1, 0, 0.5), MAKE.quaternion(yaw=math.pi / 2)),
            T0 + 1,
        ),
        ("/tf_static", TF, MAKE.transform("/mast", "/laser", (0.2, 0, 0)), T0 + 2),
        *scans(3),
        ("/odom", ODOM, MAKE.odometry(T0, 0, 0, 0, child="base_footprint"), T0),
    ]
    messages, log = read(tmp_path, entries)
    assert only_scans(messages)[0].laser.body_T_laser == pytest.approx([0.1, 0.2, math.pi / 2])
    assert log.info.details["body_frame"] == "base_footprint"


def test_laser_upside_down_by_its_transform(tmp_path):
    flipped = MAKE.quaternion(roll=math.pi)
    entries = [("/tf_static", TF, MAKE.transform("base_link", "laser", (0.2, 0, 0), flipped), T0), *scans(3)]
    laser = only_scans(read(tmp_path, entries)[0])[0].laser
    plain = only_scans(read(tmp_path, [mount(), *scans(3)])[0])[0].laser
    np.testing.assert_allclose(laser.angles_rad, -plain.angles_rad)
    assert laser.body_T_laser == pytest.approx([0.2, 0, 0])


def test_mount_on_tf_that_stands_still_and_odometry_on_tf_that_moves(tmp_path):
    entries = scans(5)
    for k in range(5):
        stamp = T0 + k * GAP
        entries += [
            ("/tf", TF, MAKE.transform("odom", "base_link", (0.1 * k, 0, 0), stamp_ns=stamp), stamp),
            ("/tf", TF, MAKE.transform("base_link", "laser", (0.3, 0, 0), stamp_ns=stamp), stamp + 1),
        ]
    messages, log = read(tmp_path, entries)
    assert only_scans(messages)[0].laser.body_T_laser == pytest.approx([0.3, 0, 0])
    poses = [m for m in messages if isinstance(m, Odometry)]
    assert [p.odom_T_body[0] for p in poses] == pytest.approx([0.1 * k for k in range(5)])
    assert log.info.details["odometry_source"] == "odom -> base_link"


def test_unknown_mount_is_said(tmp_path):
    messages, log = read(tmp_path, scans(3))
    assert only_scans(messages)[0].laser.body_T_laser == pytest.approx([0, 0, 0])
    assert "mount-unknown" in log.findings and "no-odometry" in log.findings


def test_busiest_scan_topic_unless_named(tmp_path):
    entries = [*scans(6, topic="/front"), *scans(3, topic="/rear")]
    messages, log = read(tmp_path, entries)
    assert len(messages) == 6 and "/front (6), /rear (3); /front is used" in " ".join(log.findings.lines())
    messages, _ = read(tmp_path, entries, topics=TopicChoice(scan="rear"))
    assert len(messages) == 3
    with pytest.raises(
        MfslamError, match=r"no LaserScan topic '/side'; there are: /front \(6\), /rear \(3\)"
    ):
        read(tmp_path, entries, topics=TopicChoice(scan="/side"))


def test_wheel_odometry_by_name_before_filtered(tmp_path):
    entries = [*scans(3), *odometry(3), *odometry(5, topic="/odometry/filtered")]
    _, log = read(tmp_path, entries)
    assert log.info.details["odometry_source"] == "/odom" and "several-odometry" in log.findings


def test_wheel_joints_found_by_name_or_as_set(tmp_path):
    entries = scans(3) + [
        (
            "/joint_states",
            JOINTS,
            MAKE.joints(T0 + k, arm=9.0, wheel_right_joint=2.0 * k, wheel_left_joint=1.0 * k),
            T0 + k,
        )
        for k in range(3)
    ]
    messages, _ = read(tmp_path, entries)
    assert [m for m in messages if isinstance(m, WheelAngles)][2] == WheelAngles(T0 + 2, 2.0, 4.0)
    config = load([], ["wheels.left_joint=arm", "wheels.right_joint=wheel_left_joint"])
    messages, _ = read(tmp_path, entries, config)
    assert [m for m in messages if isinstance(m, WheelAngles)][2] == WheelAngles(T0 + 2, 9.0, 2.0)
    messages, _ = read(tmp_path, entries, load([], ["wheels.swap_sides=true"]))
    assert [m for m in messages if isinstance(m, WheelAngles)][2] == WheelAngles(T0 + 2, 4.0, 2.0)
    messages, log = read(tmp_path, entries + odometry(3))
    assert not any(isinstance(m, WheelAngles) for m in messages) and "wheel-joints-unused" in log.findings
    messages, log = read(tmp_path, entries, load([], ["wheels.left_joint=nose"]))
    assert not any(isinstance(m, WheelAngles) for m in messages) and "no-wheel-joints" in log.findings


def test_imu_rate_and_heading(tmp_path):
    yawed = MAKE.quaternion(yaw=0.7)
    entries = [
        *scans(3),
        ("/imu", IMU, MAKE.imu(T0 + 1, 0.25, yawed, measured=True), T0 + 1),
        ("/imu", IMU, MAKE.imu(T0 + 2, 0.5, yawed, measured=False), T0 + 2),
        ("/imu", IMU, MAKE.imu(T0 + 3, 0.5, MAKE.quaternion(), measured=True), T0 + 3),  # never filled in
        ("/imu", IMU, MAKE.imu(T0 + 4, math.nan, yawed, measured=False), T0 + 4),
    ]
    messages, log = read(tmp_path, entries)
    full, rate, blank = [m for m in messages if isinstance(m, Imu)]
    assert (full.yaw_rate_rad_s, full.yaw_rad) == (0.25, pytest.approx(0.7))
    assert rate == Imu(T0 + 2, 0.5, None) and blank == Imu(T0 + 3, 0.5, None)
    assert log.findings.count("unusable-imu") == 1


def test_imu_upside_down_turns_its_rate(tmp_path):
    flip = MAKE.transform("base_link", "imu", (0, 0, 0), MAKE.quaternion(roll=math.pi))
    entries = [mount(), ("/tf_static", TF, flip, T0 + 1), *scans(3)]
    entries.append(
        ("/imu", IMU, MAKE.imu(T0 + 5, 0.25, MAKE.quaternion(), measured=False, frame="imu"), T0 + 5)
    )
    (imu,) = [m for m in read(tmp_path, entries)[0] if isinstance(m, Imu)]
    assert imu.yaw_rate_rad_s == pytest.approx(-0.25)


@given(st.floats(-3, 3), st.floats(-1.5, 1.5), st.floats(-3, 3), st.floats(0.95, 1.05))
def test_heading_of_a_quaternion_is_that_of_its_matrix(roll, pitch, yaw, length):
    q = MAKE.quaternion(roll, pitch, yaw)
    scaled = type(q)(x=q.x * length, y=q.y * length, z=q.z * length, w=q.w * length)
    matrix = rotation(scaled)
    assert matrix is not None and matrix @ matrix.T == pytest.approx(np.eye(3))
    assert heading(scaled) == pytest.approx(yaw_of(matrix)) == pytest.approx(yaw)


def test_bad_odometry_is_counted(tmp_path):
    zero = MAKE.types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=0.0)
    entries = [
        *scans(3),
        *odometry(2),
        ("/odom", ODOM, MAKE.odometry(T0 + 5 * GAP, 1, 1, 0, q=zero), T0 + 5 * GAP),
        ("/odom", ODOM, MAKE.odometry(T0 + 6 * GAP, math.nan, 1, 0), T0 + 6 * GAP),
    ]
    messages, log = read(tmp_path, entries)
    assert sum(isinstance(m, Odometry) for m in messages) == 2
    assert log.findings.count("unusable-/odom") == 2


def test_stamps_empty_repeated_duplicate_and_backwards(tmp_path):
    a, b = wall(1), wall(2)
    told = [(T0, a), (T0, a), (T0, b), (T0 + 2 * GAP, b), (T0 + GAP, b), (0, b)]
    entries = [("/scan", SCAN, MAKE.scan(stamp, r), T0 + k * GAP) for k, (stamp, r) in enumerate(told)]
    messages, log = read(tmp_path, entries)
    assert [m.stamp_ns for m in messages] == [T0, T0, T0 + 2 * GAP, T0 + GAP, T0 + 5 * GAP]
    counts = {code: found.count for code, found in log.findings}
    assert counts["scan-duplicate"] == counts["stamp-repeated"] == counts["stamp-backwards"] == 1
    assert counts["stamp-empty-/scan"] == 1


def test_ranges_of_all_kinds_and_changing_beams(tmp_path):
    odd = [0.05, 0.1, 10.0, math.inf, -math.inf, math.nan, 0.0, 5.0]
    entries = [
        ("/scan", SCAN, MAKE.scan(T0 + k * GAP, odd * n), T0 + k * GAP) for k, n in enumerate((1, 1, 2, 1))
    ]
    messages, log = read(tmp_path, entries)
    expected = np.array([np.nan, 0.1, np.inf, np.inf, np.nan, np.nan, np.nan, 5.0], np.float32)
    np.testing.assert_allclose(only_scans(messages)[0].ranges_m, expected)
    assert [s.ranges_m.size for s in only_scans(messages)] == [8, 8, 16, 8]
    assert log.findings.count("laser-changed") == 2


def test_no_scans(tmp_path):
    with pytest.raises(NoScans, match=r"no LaserScan or MultiEchoLaserScan topic\); it holds /odom \(3\)"):
        read(tmp_path, odometry(3))
    with pytest.raises(NoScans, match="none has two beams or more"):
        read(tmp_path, [("/scan", SCAN, MAKE.scan(T0 + k, [1.0]), T0 + k) for k in range(3)])
