"""What every log reader keeps to, whatever the format."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from log_lines import flaser, odom, robotlaser, urg
from ros_bags import TF, Make, write_bag

from drivers.base import Log, NoScans
from drivers.inspect_log import describe_log
from drivers.logs import default_presets, open_log
from mfslam.config import Config
from mfslam.settings import load, preset_path
from mfslam.types import Laser, Message, Odometry, Scan, WheelAngles, WheelTicks

COUNT, T0 = 12, 1_700_000_000


def _ranges(k: int, n: int) -> list[float]:
    return np.random.default_rng(k).uniform(0.5, 3.5, n).round(3).tolist()


def _flaser(folder: Path) -> Path:
    lines = []
    for k in range(COUNT):
        lines += [
            odom(T0 + k * 0.2, (k / 10, 0, 0)),
            flaser(T0 + k * 0.2 + 0.1, _ranges(k, 180), (k / 10, 0, 0)),
        ]
    path = folder / "log.clf"
    path.write_text("\n".join(lines) + "\n")
    return path


def _robotlaser(folder: Path) -> Path:
    path = folder / "log.log"
    lines = [
        robotlaser(T0 + k * 0.2, _ranges(k, 181), (k / 10, 0, 0), (k / 10 + 0.1, 0, 0)) for k in range(COUNT)
    ]
    path.write_text("\n".join(lines) + "\n")
    return path


def _urg(folder: Path) -> Path:
    path = folder / "log.dat"
    lines = [
        urg(10**6 + k * 10**5, 50 * k, 52 * k, [int(r * 1000) for r in _ranges(k, 682)]) for k in range(COUNT)
    ]
    path.write_text("\n".join(lines) + "\n")
    return path


def _bag(kind: str) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        make = Make("ros1" if kind == "ros1" else "ros2")
        entries = [("/tf_static", TF, make.transform("base_link", "laser", (0.1, 0, 0)), T0 * 10**9)]
        for k in range(COUNT):
            stamp = T0 * 10**9 + k * 10**8
            entries += [
                ("/odom", "nav_msgs/msg/Odometry", make.odometry(stamp, k / 10, 0, 0), stamp),
                ("/scan", "sensor_msgs/msg/LaserScan", make.scan(stamp, _ranges(k, 360)), stamp + 1),
            ]
        return write_bag(folder / ("log.bag" if kind == "ros1" else "log"), kind, entries)

    return write


LOGS = {
    "flaser": _flaser,
    "robotlaser": _robotlaser,
    "urg-text": _urg,
    "ros1": _bag("ros1"),
    "sqlite3": _bag("sqlite3"),
    "mcap": _bag("mcap"),
}


@pytest.fixture(params=LOGS)
def path(request, tmp_path) -> Path:
    return LOGS[request.param](tmp_path)


def _config(path: Path) -> Config:
    return load([preset_path(name) for name in default_presets(path)])


def _read(path: Path) -> tuple[list[Message], Log]:
    with open_log(path, _config(path)) as log:
        return list(log), log


def test_messages_are_typed_finite_and_in_order(path):
    messages, log = _read(path)
    scans = [m for m in messages if isinstance(m, Scan)]
    assert len(scans) == COUNT
    assert [m.stamp_ns for m in messages] == sorted(m.stamp_ns for m in messages)
    for message in messages:
        assert type(message.stamp_ns) is int
        if isinstance(message, Scan):
            assert message.ranges_m.dtype == np.float32 and message.ranges_m.flags.owndata
            assert np.isfinite(message.ranges_m).all()
        elif isinstance(message, Odometry):
            assert message.odom_T_body.shape == (3,) and np.isfinite(message.odom_T_body).all()
        elif isinstance(message, WheelTicks):
            assert type(message.left) is int and type(message.right) is int
        else:
            assert isinstance(message, WheelAngles)
    np.testing.assert_allclose(scans[3].ranges_m, _ranges(3, scans[3].ranges_m.size), atol=1.1e-3)
    assert log.findings.lines() == []


def test_one_laser_is_shared_by_all_scans(path):
    lasers = {id(m.laser): m.laser for m in _read(path)[0] if isinstance(m, Scan)}
    assert len(lasers) == 1
    laser: Laser = next(iter(lasers.values()))
    assert np.isfinite(laser.angles_rad).all() and np.isfinite(laser.offsets_s).all()
    assert laser.body_T_laser.shape == (3,) and 0 <= laser.range_min_m < laser.range_max_m < 1e4


def test_progress_goes_from_nothing_to_all(path):
    with open_log(path, _config(path)) as log:
        shares = [log.progress() for _ in log]
        assert log.progress() == 1.0
    assert all(0.0 <= share <= 1.0 for share in shares) and shares == sorted(shares)


def test_reading_twice_gives_the_same(path):
    def digest() -> list[tuple[str, int, bytes]]:
        return [
            (type(m).__name__, m.stamp_ns, m.ranges_m.tobytes() if isinstance(m, Scan) else b"")
            for m in _read(path)[0]
        ]

    assert digest() == digest()


def test_details_every_driver_gives(path):
    _, log = _read(path)
    details = log.info.details
    assert log.info.path == path and log.info.format in ("carmen", "urg-text", "ros1", "ros2")
    assert details["messages"][details["scan_source"]] == COUNT
    assert details["odometry"] in ("moving", "present")


def test_description_counts_what_was_read(path):
    description = describe_log(path, _config(path))
    told = json.loads(json.dumps(description.as_json(), allow_nan=False))
    assert told["messages"]["Scan"] == COUNT and told["lasers"][0]["scans"] == COUNT
    assert told["stamps"]["backwards"] == told["stamps"]["repeated"] == 0
    assert told["odometry"]["jumps"] == 0 and told["odometry"]["distance_m"] > 0.05
    assert f"{COUNT} Scan" in description.text() and "odd       nothing" in description.text()


@pytest.mark.parametrize("kind", ["flaser", "robotlaser", "urg-text"])
def test_text_without_its_scans_is_no_scans(tmp_path, kind):
    path = LOGS[kind](tmp_path)
    keep = {"flaser": 100, "robotlaser": 100, "urg-text": 703}[kind]
    cut = [" ".join(line.split()[:keep]) for line in path.read_text().splitlines()]
    path.write_text("\n".join(cut) + "\n")
    with pytest.raises(NoScans), open_log(path, _config(path)) as log:
        list(log)
