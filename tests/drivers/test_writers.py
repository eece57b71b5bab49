"""Logs that are written read back as they were, by the project's readers and by rosbags itself."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

from drivers.logs import default_presets, open_log
from drivers.simulator import Motion, RobotModel, Simulation, laser_model, load_world, simulate
from drivers.writers import FORMATS, write_log, write_relations, write_tum
from drivers.writers.log import format_of, log_stem
from mfslam import se2
from mfslam.config import WheelsConfig
from mfslam.metrics import read_relations, relations_error
from mfslam.settings import load, preset_path
from mfslam.types import (
    Imu,
    Laser,
    Message,
    MfslamError,
    Odometry,
    Scan,
    WheelAngles,
    WheelTicks,
)

WHEELS = WheelsConfig(radius_left_m=0.077, radius_right_m=0.077, track_m=0.33, ticks_per_turn=4000)
DRIVE = Motion.from_twists([1.0, 1.0, 1.0], [[1.0, 0.0, 0.5], [2.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
BAGS = ["log.bag", "log.db3", "log.mcap"]


def simulated(laser: str = "fast", **robot) -> Simulation:
    model = laser_model(laser, (0.15, -0.02, 0.05))
    return simulate(load_world("office"), RobotModel(wheels=WHEELS, **robot), model, motion=DRIVE, seed=3)


def read(path: Path, settings=()) -> list[Message]:
    presets = [preset_path(name) for name in default_presets(path)]
    with open_log(path, load(presets, settings)) as log:
        return list(log)


def of(kind, messages):
    return [m for m in messages if isinstance(m, kind)]


def assert_same_scans(written, got, *, angle=1e-6, offset=1e-8):
    written, got = of(Scan, written), of(Scan, got)
    assert [s.stamp_ns for s in got] == [s.stamp_ns for s in written]
    for a, b in zip(written, got, strict=True):
        np.testing.assert_array_equal(a.ranges_m, b.ranges_m)
        np.testing.assert_allclose(b.laser.angles_rad, a.laser.angles_rad, rtol=0, atol=angle)
        np.testing.assert_allclose(b.laser.offsets_s, a.laser.offsets_s, rtol=0, atol=offset)
        apart = se2.between(a.laser.body_T_laser, b.laser.body_T_laser)
        np.testing.assert_allclose(apart, 0.0, atol=2e-9)


def poses_by_stamp(messages) -> dict[int, np.ndarray]:
    found = {m.stamp_ns: m.odom_T_body for m in of(Odometry, messages)}
    found.update({s.stamp_ns: s.odom_T_body for s in of(Scan, messages) if s.odom_T_body is not None})
    return found


@pytest.mark.parametrize("name", [*BAGS, "log.clf", "log.clf.gz", "log.log.bz2"])
def test_scans_and_odometry_come_back_exactly(tmp_path, name):
    log = simulated()
    assert not len(write_log(log.messages, tmp_path / name))
    settings = [] if name in BAGS else ["sensor.turn_period_s=0.1"]  # CARMEN does not tell
    got = read(tmp_path / name, settings)
    assert_same_scans(log.messages, got)
    before, after = poses_by_stamp(log.messages), poses_by_stamp(got)
    assert before.keys() == after.keys()
    for stamp, pose in before.items():
        np.testing.assert_allclose(after[stamp], pose, rtol=0, atol=1e-9)


@pytest.mark.parametrize("laser", ["sick-lms200", "sick-lms291", "urg-04lx"])
def test_carmen_tells_each_laser_by_its_form(tmp_path, laser):
    """SICK geometry as FLASER, interlaced beams and all; any other as ROBOTLASER1."""
    log = simulated(laser)
    write_log(log.messages, tmp_path / "log.clf")
    text = (tmp_path / "log.clf").read_text()
    assert ("\nFLASER " in text) == laser.startswith("sick")
    assert ("\nROBOTLASER1 " in text) != laser.startswith("sick")
    assert_same_scans(log.messages, read(tmp_path / "log.clf"))


def test_a_rear_laser_is_an_rlaser(tmp_path):
    model = laser_model("sick-lms200", (-0.2, 0.0, math.pi))
    log = simulate(load_world("office"), RobotModel(), model, motion=DRIVE)
    write_log(log.messages, tmp_path / "log.clf")
    assert_same_scans(log.messages, read(tmp_path / "log.clf"))
    assert "\nRLASER " in (tmp_path / "log.clf").read_text()


@pytest.mark.parametrize("name", BAGS)
def test_a_laser_that_turns_clockwise_keeps_its_times(tmp_path, name):
    """Beams in the order sensed: angles fall, instants rise."""
    log = simulated("rplidar-a2")
    write_log(log.messages, tmp_path / name)
    written, got = log.scans, of(Scan, read(tmp_path / name))
    for a, b in zip(written, got, strict=True):
        np.testing.assert_array_equal(a.ranges_m[::-1], b.ranges_m)
        np.testing.assert_allclose(b.laser.angles_rad, a.laser.angles_rad[::-1], atol=1e-6)
        instants = b.stamp_ns * 1e-9 + b.laser.offsets_s - a.stamp_ns * 1e-9
        np.testing.assert_allclose(instants, a.laser.offsets_s[::-1], atol=1e-6)


def test_interlaced_beams_in_a_bag_get_their_mean_slope_and_that_is_told(tmp_path):
    log = simulated("sick-lms291")
    findings = write_log(log.messages, tmp_path / "log.mcap")
    assert findings.count("uneven-beam-times") == 1
    scan = of(Scan, read(tmp_path / "log.mcap"))[0]
    offsets = scan.laser.offsets_s + (scan.stamp_ns - log.scans[0].stamp_ns) * 1e-9
    assert np.mean(offsets) == pytest.approx(np.mean(log.scans[0].laser.offsets_s), abs=1e-9)
    assert np.max(np.abs(np.diff(offsets, 2))) < 1e-12


@pytest.mark.parametrize("name", BAGS)
def test_gyro_compass_and_wheels_come_back(tmp_path, name):
    log = simulated(odometry="ticks", gyro_rate_hz=50.0, compass_sigma_rad=0.01)
    write_log(log.messages, tmp_path / name, wheels=WHEELS)
    got = read(tmp_path / name)
    for a, b in zip(of(Imu, log.messages), of(Imu, got), strict=True):
        assert (a.stamp_ns, a.yaw_rate_rad_s) == (b.stamp_ns, b.yaw_rate_rad_s)
        assert b.yaw_rad == pytest.approx(a.yaw_rad, abs=1e-12)
    turn = 2.0 * math.pi / WHEELS.ticks_per_turn
    for ticks, angles in zip(of(WheelTicks, log.messages), of(WheelAngles, got), strict=True):
        assert ticks.stamp_ns == angles.stamp_ns
        assert (angles.left_rad, angles.right_rad) == pytest.approx(
            (ticks.left * turn, ticks.right * turn), abs=1e-12
        )


def test_a_gyro_without_a_compass_has_no_heading(tmp_path):
    log = simulated(gyro_rate_hz=50.0)
    write_log(log.messages, tmp_path / "log.mcap")
    assert all(m.yaw_rad is None for m in of(Imu, read(tmp_path / "log.mcap")))


def test_urg_text_keeps_ticks_microseconds_and_millimetres(tmp_path):
    model = laser_model("urg-04lx", (0.145, 0.0, 0.0))
    robot = RobotModel(wheels=WHEELS, odometry="ticks", encoder_rate_hz=None)
    log = simulate(load_world("office"), robot, model, motion=DRIVE, start_ns=361_431_443_000)
    write_log(log.messages, tmp_path / "log.dat")
    got = read(tmp_path / "log.dat")
    assert [(t.stamp_ns, t.left, t.right) for t in of(WheelTicks, got)] == [
        (t.stamp_ns, t.left, t.right) for t in of(WheelTicks, log.messages)
    ]
    for a, b in zip(log.scans, of(Scan, got), strict=True):
        assert a.stamp_ns == b.stamp_ns
        np.testing.assert_allclose(b.ranges_m, a.ranges_m, atol=1e-6)
    columns = (tmp_path / "log.dat").read_text().splitlines()[0].split()
    assert len(columns) == 24 + 682 + 1 and columns[0] == "361431443"


def test_ros2_bags_are_folders_or_bare_files(tmp_path):
    from rosbags.highlevel import AnyReader

    log = simulated()
    for kind, suffix in (("ros2-mcap", ".mcap"), ("ros2-sqlite3", ".db3")):
        folder = tmp_path / kind
        write_log(log.messages, folder, kind)
        assert sorted(p.name for p in folder.iterdir()) == sorted([f"{kind}{suffix}", "metadata.yaml"])
        with AnyReader([folder]) as bag:
            topics = {c.topic: (c.msgtype, c.msgcount) for c in bag.connections}
            order = [stamp for _, stamp, _ in bag.messages()]
        assert topics["/scan"] == ("sensor_msgs/msg/LaserScan", len(log.scans))
        assert topics["/tf_static"] == ("tf2_msgs/msg/TFMessage", 1)
        assert topics["/odom"] == ("nav_msgs/msg/Odometry", len(of(Odometry, log.messages)))
        assert order == sorted(set(order))
        write_log(log.messages, tmp_path / f"bare{suffix}")
        assert (tmp_path / f"bare{suffix}").is_file()


def test_laserscan_says_what_ros_says_it_should(tmp_path):
    from rosbags.highlevel import AnyReader

    log = simulated()
    write_log(log.messages, tmp_path / "log.bag")
    with AnyReader([tmp_path / "log.bag"]) as bag:
        connections = [c for c in bag.connections if c.topic == "/scan"]
        connection, _, raw = next(bag.messages(connections))
        scan = bag.deserialize(raw, connection.msgtype)
    laser = log.scans[0].laser
    assert scan.header.frame_id == "laser"
    assert scan.header.stamp.sec * 10**9 + scan.header.stamp.nanosec == log.scans[0].stamp_ns
    assert scan.time_increment == pytest.approx(0.1 * 0.375 / 360.0)
    assert scan.scan_time == pytest.approx(0.1)
    assert scan.angle_min == pytest.approx(laser.angles_rad[0])
    assert scan.angle_max == pytest.approx(laser.angles_rad[-1])
    assert scan.range_max == pytest.approx(10.0)


@pytest.mark.parametrize("name", [*BAGS, "log.clf"])
def test_order_is_kept_where_stamps_lie(tmp_path, name):
    log = simulated(odometry="none")
    shuffled = [dataclasses.replace(s) for s in log.scans]
    shuffled[3], shuffled[7] = shuffled[7], shuffled[3]
    write_log(shuffled, tmp_path / name)
    assert [s.stamp_ns for s in of(Scan, read(tmp_path / name))] == [s.stamp_ns for s in shuffled]


def test_recorded_carmen_log_survives_a_ros_bag(tmp_path, shared_data):
    log = shared_data / "freiburg" / "intel.clf.gz"
    # a bag stamps the first ray: as here, so that stamps can be compared
    some = [m for m, _ in zip(read(log, ["sensor.stamp_at=first"]), range(6000), strict=False)]
    write_log(some, tmp_path / "intel.mcap")
    got = read(tmp_path / "intel.mcap")
    assert_same_scans(some, got)
    before, after = poses_by_stamp(some), poses_by_stamp(got)
    assert before.keys() == after.keys()
    assert max(float(np.max(np.abs(after[t] - before[t]))) for t in before) < 1e-9


@pytest.mark.parametrize("name", ["log.clf.gz", "log.bag", "log.mcap", "log.dat"])
def test_same_messages_same_bytes(tmp_path, name):
    if name == "log.dat":
        model = laser_model("urg-04lx")
        robot = RobotModel(odometry="ticks", encoder_rate_hz=None)
        messages = simulate(load_world("office"), robot, model, motion=DRIVE).messages
    else:
        messages = simulated().messages
    (tmp_path / "b").mkdir()
    for folder in (tmp_path, tmp_path / "b"):
        write_log(messages, folder / name)
    assert (tmp_path / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_refusals_are_one_clear_line_and_leave_nothing(tmp_path):
    log, ticks = simulated(), simulated(odometry="ticks")
    odd = dataclasses.replace(
        log.scans[0].laser, angles_rad=np.sort(np.random.default_rng(0).uniform(-1, 1, 721))
    )
    odd_scan = Scan(1, log.scans[0].ranges_m, odd, np.zeros(3))
    cases = [
        (log.messages, "log.txt", None, "no log format known by this suffix"),
        (log.messages, "log", "rosbag", "no log format 'rosbag'"),
        (ticks.messages, "log.clf", None, "not wheel ticks"),
        (ticks.messages, "log.bag", None, "ticks_per_turn"),
        (log.messages, "log.dat", None, "682 beams"),
        (simulated("urg-04lx").messages, "log.dat", None, "encoder ticks of the same instant"),
        ([odd_scan], "log.bag", None, "even step"),
        ([odd_scan], "log.clf", None, "even step"),
        ([dataclasses.replace(log.scans[0], stamp_ns=-1)], "log.mcap", None, "no time before 0"),
    ]
    for messages, name, kind, said in cases:
        with pytest.raises(MfslamError) as caught:
            write_log(messages, tmp_path / name, kind)
        assert said in str(caught.value) and "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_an_existing_log_is_kept_unless_told(tmp_path):
    log = simulated()
    path = tmp_path / "log.clf"
    path.write_text("mine")
    with pytest.raises(MfslamError, match="exists already"):
        write_log(log.messages, path)
    assert path.read_text() == "mine"
    write_log(log.messages, path, overwrite=True)
    assert len(of(Scan, read(path, ["sensor.turn_period_s=0.1"]))) == len(log.scans)
    assert [p.name for p in tmp_path.iterdir()] == ["log.clf"]


def test_what_a_format_cannot_hold_is_counted(tmp_path):
    log = simulated(gyro_rate_hz=10.0)
    assert write_log(log.messages, tmp_path / "log.clf").count("gyro-not-held") == len(of(Imu, log.messages))
    bare = simulated("sick-lms200", odometry="none")
    assert write_log(bare.messages, tmp_path / "bare.clf").count("no-odometry") == len(bare.scans)


def test_formats_are_all_named():
    assert FORMATS == ("carmen", "urg-text", "ros1", "ros2-sqlite3", "ros2-mcap")


def test_truth_as_relations_scores_the_truth_at_zero(tmp_path):
    log = simulated()
    path = tmp_path / "truth.relations"
    write_relations(path, log.truth_stamps_ns, log.truth_world_T_body, per_scale=50)
    error = relations_error(log.truth_stamps_ns, log.truth_world_T_body, read_relations(path))
    shifted = se2.compose(np.array([3.0, -1.0, 2.0]), log.truth_world_T_body)
    again = relations_error(log.truth_stamps_ns, shifted, read_relations(path))
    for result in (error, again):
        assert result.matched > 60 and result.unmatched == 0
        assert result.translation_m.mean < 1e-8 and result.rotation_deg.mean < 1e-6


def test_truth_as_tum_has_exact_stamps_and_unit_quaternions(tmp_path):
    log = simulated()
    stamps = log.truth_stamps_ns + 7
    write_tum(tmp_path / "truth.tum", stamps, log.truth_world_T_body)
    rows = [line.split() for line in (tmp_path / "truth.tum").read_text().splitlines()]
    assert [int(r[0].replace(".", "")) for r in rows] == stamps.tolist()
    values = np.array(rows, dtype=float)
    np.testing.assert_allclose(np.sum(values[:, 4:] ** 2, axis=1), 1.0, atol=1e-11)
    yaw = 2.0 * np.arctan2(values[:, 6], values[:, 7])
    np.testing.assert_allclose(se2.wrap(yaw - log.truth_world_T_body[:, 2]), 0.0, atol=1e-10)
    np.testing.assert_allclose(values[:, 1:3], log.truth_world_T_body[:, :2], atol=1e-9)


def test_two_lasers_get_two_topics(tmp_path):
    log = simulated()
    rear: Laser = dataclasses.replace(log.scans[0].laser, body_T_laser=np.array([-0.3, 0.0, math.pi]))
    both: list[Message] = []
    for scan in log.scans:
        both += [scan, dataclasses.replace(scan, laser=rear, stamp_ns=scan.stamp_ns + 1000)]
    write_log(both, tmp_path / "log.bag")
    from rosbags.highlevel import AnyReader

    with AnyReader([tmp_path / "log.bag"]) as bag:
        counts = {c.topic: c.msgcount for c in bag.connections}
    assert counts["/scan"] == counts["/scan_2"] == len(log.scans)
    assert counts["/tf_static"] == 2


@pytest.mark.parametrize("name", ["log.clf", "log.db3", "log.mcap"])
def test_a_place_that_cannot_be_written_is_one_clear_line(tmp_path, name):
    (tmp_path / "file").write_text("not a folder")
    with pytest.raises(MfslamError, match="cannot be written"):
        write_log(simulated().messages, tmp_path / "file" / name)
    with pytest.raises(MfslamError, match="cannot be written"):
        write_tum(tmp_path / "file" / "truth.tum", np.zeros(1, np.int64), np.zeros((1, 3)))
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize(
    ("name", "kind", "stem"),
    [
        ("a.clf", "carmen", "a"),
        ("a.log.bz2", "carmen", "a"),
        ("a.b.dat.gz", "urg-text", "a.b"),
        ("a.bag", "ros1", "a"),
        ("a.mcap", "ros2-mcap", "a"),
        ("a.db3", "ros2-sqlite3", "a"),
        ("a", "ros2-mcap", "a"),
    ],
)
def test_suffix_tells_the_format(name, kind, stem):
    assert format_of(Path(name)) == kind
    assert log_stem(Path(name)) == stem
