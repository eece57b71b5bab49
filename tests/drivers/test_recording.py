"""Acquisition and recording under what ends them: real bytes, real processes, files as they are found after."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from sent_scans import check_recorded, sent_for_s

from drivers.acquisition.feed import AcquisitionFeed
from drivers.acquisition.pump import Pump
from drivers.acquisition.sources import Sources
from drivers.laser_models import LogGeometry, laser_from
from drivers.logs import open_log
from drivers.own_process import command, environment
from drivers.scip.sensor import UrgSensor
from drivers.simulator import RobotModel, laser_model, load_world, simulate
from drivers.simulator.devices.serve import Cast, SimulatedSensors
from drivers.simulator.devices.wire import LineFault, LineFaults
from drivers.simulator.simulate import without_pose
from drivers.writers.recorder import Recorder
from mfslam.config import Config
from mfslam.settings import load
from mfslam.types import Findings, Imu, Message, MfslamError, Scan, WheelAngles, WheelTicks

SIMULATED = ["--lidar", "sim:demo", "--wheels", "sim"]


def read(path: Path) -> tuple[list[Message], Findings]:
    with open_log(path, Config()) as log:
        return list(log), log.findings


def scans_of(messages: list[Message]) -> list[Scan]:
    return [m for m in messages if isinstance(m, Scan)]


def record(*more: str, **options: object) -> subprocess.Popen[str]:
    arguments = [sys.executable, "-m", "mfslam.cli", "record", *more]
    return subprocess.Popen(arguments, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True, **options)  # type: ignore[call-overload,no-any-return]


def wait_for_size(path: Path, size: int) -> None:
    for _ in range(300):
        if path.exists() and path.stat().st_size > size:
            return
        time.sleep(0.1)
    raise AssertionError(f"{path} does not grow")


@pytest.fixture(scope="module")
def drive() -> list[Message]:
    robot = RobotModel(odometry="ticks", gyro_rate_hz=50.0, compass_sigma_rad=0.01)
    messages = simulate(load_world("demo"), robot, laser_model("fast"), seed=1).messages
    return [without_pose(m) for m in messages[:2000]]


# --- the file -----------------------------------------------------------------------------------------


def test_what_is_recorded_is_read_and_other_tools_open_it(tmp_path: Path, drive: list[Message]) -> None:
    path = tmp_path / "log.mcap"
    with Recorder(path, Config(), {"lidar": "test"}) as recorder:
        for message in drive:
            recorder.add(message)
    messages, findings = read(path)
    assert "salvaged" not in findings
    for kind, told in ((Scan, Scan), (Imu, Imu), (WheelTicks, WheelAngles)):
        before = [m.stamp_ns for m in drive if isinstance(m, kind)]
        assert before and [m.stamp_ns for m in messages if isinstance(m, told)] == before
    for a, b in zip(scans_of(drive), scans_of(messages), strict=True):
        np.testing.assert_array_equal(a.ranges_m, b.ranges_m)
        np.testing.assert_allclose(a.laser.offsets_s, b.laser.offsets_s, atol=1e-6)
    with path.open("rb") as file:
        summary = make_reader(file, validate_crcs=True).get_summary()
        assert summary is not None and summary.statistics is not None
        assert summary.statistics.message_count == len(drive) + 1  # and the mount
        assert {s.name for s in summary.schemas.values()} == {
            "sensor_msgs/msg/LaserScan", "sensor_msgs/msg/Imu", "sensor_msgs/msg/JointState", "tf2_msgs/msg/TFMessage",
        }  # fmt: skip
    with AnyReader([path]) as bag:
        assert bag.message_count == len(drive) + 1


@pytest.mark.parametrize("torn", [0, 40, 700])
def test_what_was_synced_survives_a_power_cut(tmp_path: Path, drive: list[Message], torn: int) -> None:
    """The file as the disk has it: whole chunks, and maybe part of the next one."""
    path, cut = tmp_path / "log.mcap", tmp_path / "cut.mcap"
    recorder = Recorder(path, Config())
    synced = [0]
    for k, message in enumerate(drive):
        recorder.add(message)
        if k % 300 == 299:
            recorder.sync()
            synced.append(k + 1)
    data = path.read_bytes()
    cut.write_bytes(data[: len(data) - torn])
    recorder.close()
    messages, findings = read(cut)
    assert "salvaged" in findings
    assert len(messages) >= synced[-1 if torn == 0 else -2]
    expected = {s.stamp_ns: s for s in scans_of(drive)}
    for scan in scans_of(messages):
        np.testing.assert_array_equal(scan.ranges_m, expected[scan.stamp_ns].ranges_m)


@pytest.mark.parametrize("read_with", ["the same settings", "none"])
def test_a_laser_that_hangs_upside_down_and_is_late_is_so_once(tmp_path: Path, read_with: str) -> None:
    path = tmp_path / "log.mcap"
    config = load(
        settings=["sensor.upside_down=true", "sensor.transport_delay_s=-0.05", "sensor.mount_yaw_deg=20"]
    )
    told = LogGeometry(n_beams=4, angle_min_rad=-1.0, angle_step_rad=0.5, turn_period_s=0.1)
    scan = Scan(10**18, np.full(4, 2.0, np.float32), laser_from(config.sensor, told))
    with Recorder(path, config) as recorder:
        recorder.add(scan)
    again = config if read_with != "none" else Config()
    with open_log(path, again) as log:
        (found,) = scans_of(list(log))
    assert found.stamp_ns == scan.stamp_ns
    np.testing.assert_allclose(found.laser.angles_rad, scan.laser.angles_rad, atol=1e-6)
    np.testing.assert_allclose(found.laser.body_T_laser, scan.laser.body_T_laser, atol=1e-12)
    late_s = -0.05 if read_with != "none" else 0.0
    np.testing.assert_allclose(found.laser.offsets_s, scan.laser.offsets_s + 0.05 + late_s, atol=1e-6)


def test_a_recording_never_replaces_a_file(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    path.write_bytes(b"precious")
    with pytest.raises(MfslamError, match="exists already"):
        Recorder(path)
    assert path.read_bytes() == b"precious"


# --- the command --------------------------------------------------------------------------------------


def test_ctrl_c_ends_a_recording_well(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    process = record(*SIMULATED, "-o", str(path), "--set", "sensor.mount_x_m=0.1")
    wait_for_size(path, 40_000)
    process.send_signal(signal.SIGINT)
    out, told = process.communicate(timeout=30)
    assert process.returncode == 0 and "mfslam map" in out and "Traceback" not in told
    messages, findings = read(path)
    assert "salvaged" not in findings
    assert scans_of(messages)[0].laser.body_T_laser[0] == pytest.approx(0.1)
    assert {type(m) for m in messages} == {Scan, WheelAngles, Imu}


def test_kill_9_costs_at_most_the_last_second(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    process = record(*SIMULATED, "-o", str(path))
    wait_for_size(path, 40_000)
    process.kill()
    killed_s = time.time()
    process.communicate()
    messages, findings = read(path)
    assert "salvaged" in findings
    assert killed_s - messages[-1].stamp_ns * 1e-9 < 1.5  # half a second, and what a busy machine adds


def test_a_full_disk_is_told_and_what_was_recorded_stays(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"

    def small_disk() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, 60_000))

    process = record(*SIMULATED, "-o", str(path), preexec_fn=small_disk)
    _, told = process.communicate(timeout=60)
    assert process.returncode == 1 and "recording stopped: file too large" in told and "can be mapped" in told
    messages, findings = read(path)
    assert len(scans_of(messages)) > 5 and "salvaged" in findings and path.stat().st_size <= 60_000


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--lidar", "urg:/dev/nowhere"], "urg:/dev/nowhere: cannot be opened: no such file or directory"),
        (["--lidar", "urg:127.0.0.1:9"], "cannot be reached"),
        (["--lidar", "sick:/dev/ttyS0"], "expected one of urg:DEVICE"),
        (["--lidar", "sim:nowhere"], "no world"),
        (["--lidar", "sim:demo@urg-05"], "no simulated laser"),
        (
            ["--lidar", "rplidar:/dev/ttyUSB0"],
            "expected rplidar:MODEL:DEVICE; models: A1, A2, A3, C1, S1, S2, S3",
        ),
        (["--lidar", "rplidar:A9:/dev/ttyUSB0"], "expected rplidar:MODEL:DEVICE"),
        (["--lidar", "rplidar:s2:/dev/nowhere"], "rplidar:s2:/dev/nowhere: cannot be opened"),
        (["--wheels", "sim"], "needs the world of a simulated lidar"),
        (["--lidar", "sim:demo", "--wheels", "sim:arm"], "--wheels sim:arm: expected one of board:DEVICE"),
        (["--lidar", "sim:demo", "--wheels", "board:/dev/nowhere"], "board:/dev/nowhere: cannot be opened"),
        ([], "expected --lidar or --wheels"),
        (["--lidar", "sim:demo", "--duration", "nan"], "--duration nan: expected more than 0 s"),
    ],
)
def test_what_is_not_there_is_one_line_and_no_file(tmp_path: Path, arguments: list[str], told: str) -> None:
    path = tmp_path / "log.mcap"
    process = record(*arguments, "-o", str(path), "-q")
    _, error = process.communicate(timeout=60)
    assert process.returncode == 1 and told in error and len(error.splitlines()) == 1
    assert not path.exists()


def test_a_folder_of_the_users_hides_no_package_of_ours(tmp_path: Path) -> None:
    (tmp_path / "drivers").mkdir()
    (tmp_path / "drivers" / "__init__.py").touch()
    arguments = command(
        "mfslam.cli", "record", "--lidar", "sim:nowhere", "-o", str(tmp_path / "log.mcap"), "-q"
    )
    done = subprocess.run(
        arguments, env=environment(), cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert "no world" in done.stderr


# --- a process of its own -----------------------------------------------------------------------------


def test_acquisition_does_not_import_gtsam() -> None:
    code = "import sys, drivers.acquisition.__main__, drivers.scip.sensor; sys.exit('gtsam' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_a_reader_that_stalls_misses_nothing_and_a_killed_acquisition_is_told(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    got: list[Message] = []
    with pytest.raises(MfslamError, match=r"was killed \(SIGKILL\).*all but the last second"):
        read_until_killed(path, got)
    messages, findings = read(path)
    recorded = [s.stamp_ns for s in scans_of(messages)]
    assert "salvaged" in findings and len(recorded) > 15
    assert [s.stamp_ns for s in scans_of(got)][: len(recorded)] == recorded


def read_until_killed(path: Path, got: list[Message]) -> None:
    with AcquisitionFeed(Sources("sim:demo", "sim"), Config(), path) as feed:
        while len(scans_of(got)) < 5:
            message = feed.poll(1.0)
            got += [] if message is None else [message]
        time.sleep(2.0)  # the reader stalls
        while len(scans_of(got)) < 35:
            message = feed.poll(1.0)
            got += [] if message is None else [message]
        assert {s["connected"] for s in feed.health.sensors} == {True}
        os.kill(feed.process.pid, signal.SIGKILL)
        while True:
            feed.poll(1.0)


def test_the_recording_is_finished_when_its_reader_is_killed(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    code = (
        "from drivers.acquisition.feed import AcquisitionFeed; from drivers.acquisition.sources import Sources;"
        "from mfslam.config import Config; from pathlib import Path; import sys\n"
        "with AcquisitionFeed(Sources('sim:demo', 'sim'), Config(), Path(sys.argv[1])) as feed:\n"
        "    print(feed.process.pid, flush=True)\n"
        "    for message in feed: pass\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code, str(path)], stdout=subprocess.PIPE, text=True, start_new_session=True
    )
    assert process.stdout is not None
    acquisition = int(process.stdout.readline())
    wait_for_size(path, 30_000)
    process.kill()
    process.communicate()
    for _ in range(200):
        if not Path(f"/proc/{acquisition}").exists():
            break
        time.sleep(0.1)
    else:
        os.kill(acquisition, signal.SIGKILL)
        raise AssertionError("the acquisition goes on although its reader is gone")
    messages, findings = read(path)
    assert len(scans_of(messages)) > 5 and "salvaged" not in findings


def test_a_stop_ends_the_feed_with_a_whole_recording(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    count = 0
    with AcquisitionFeed(Sources("sim:demo", "sim:arduino"), Config(), path) as feed:
        for message in feed:
            assert isinstance(message, Scan | WheelTicks)
            count += 1
            if count == 50:
                feed.stop()
        assert feed.over
    recorded, findings = read(path)
    assert len(recorded) == count and "salvaged" not in findings
    assert feed.process.end() == 0


# --- faults on the line -------------------------------------------------------------------------------


def recorded_under(faults: LineFaults, folder: Path, done: Callable[[Path], bool]) -> tuple[UrgSensor, Pump]:
    """Record a simulated laser into log.mcap, with what it has sent in sent.jsonl, until that will do."""
    sent_path, end_s = folder / "sent.jsonl", time.monotonic() + 60.0
    with SimulatedSensors(Cast("demo", laser_faults=faults, record=str(sent_path))) as sim:
        sensor = UrgSensor(str(sim.lidar), Config())
        with Pump([sensor], Recorder(folder / "log.mcap")) as pump:
            while not done(sent_path) and time.monotonic() < end_s:
                pump.poll(0.1)
    return sensor, pump


def test_the_recording_holds_every_scan_whose_checksum_was_right(tmp_path: Path) -> None:
    """Flipped bits, garbage, half lines, an error of the sensor, the laser off, and the cable pulled."""
    events = (
        LineFault(1.0, "garbage", 500), LineFault(1.5, "lost", 300), LineFault(2.0, "status", 21),
        LineFault(5.5, "laser-off"), LineFault(9.0, "unplug", 1.0),
    )  # fmt: skip
    faults = LineFaults(bit_flips=2e-5, once=events)
    sensor, pump = recorded_under(faults, tmp_path, lambda path: sent_for_s(path) > 12.0)
    sent, whole, recorded = check_recorded(scans_of(read(tmp_path / "log.mcap")[0]), tmp_path / "sent.jsonl")
    assert sent > whole and recorded > 25 and sensor.health.reconnects >= 2
    assert {"sensor-checksum", "sensor-status-21", "sensor-status-98"} <= {c for c, _ in pump.findings}


def test_of_a_line_that_flips_one_bit_in_ten_thousand_the_recording_holds_what_came_over_whole(
    tmp_path: Path,
) -> None:
    sensor, pump = recorded_under(LineFaults(1e-4), tmp_path, lambda path: sent_for_s(path) > 8.0)
    sent, whole, recorded = check_recorded(scans_of(read(tmp_path / "log.mcap")[0]), tmp_path / "sent.jsonl")
    assert 6 < recorded <= whole < 0.4 * sent  # one in six: a scan has 17,000 bits
    assert sensor.health.connected and "sensor-checksum" in pump.findings
