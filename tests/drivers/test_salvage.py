"""Recordings that were cut off, damaged, or whose index is missing or wrong: what is whole in them is read."""

from __future__ import annotations

import shutil
import sqlite3
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from ros_bags import Entry, Make, write_bag
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore

from drivers.logs import open_log
from mfslam.config import Config
from mfslam.types import Findings, MfslamError, Scan

SCAN = "sensor_msgs/msg/LaserScan"
T0, GAP, COUNT = 1_700_000_000_000_000_000, 100_000_000, 200
KINDS = ["ros1", "sqlite3", "mcap"]


def ranges(k: int) -> list[float]:
    return np.random.default_rng(k).uniform(1, 9, 100).astype(np.float32).tolist()


def entries(kind: str) -> list[Entry]:
    make = Make("ros1" if kind == "ros1" else "ros2")
    return [("/scan", SCAN, make.scan(T0 + k * GAP, ranges(k)), T0 + k * GAP) for k in range(COUNT)]


@pytest.fixture(scope="session")
def bags(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """One whole bag file of each kind."""
    folder = tmp_path_factory.mktemp("bags")
    out = {}
    for kind in KINDS:
        path = write_bag(folder / (f"{kind}.bag" if kind == "ros1" else kind), kind, entries(kind))
        out[kind] = path if path.is_file() else next(p for p in path.iterdir() if p.suffix != ".yaml")
    return out


def read(path: Path) -> tuple[list[Scan], Findings]:
    with open_log(path, Config()) as log:
        return [m for m in log if isinstance(m, Scan)], log.findings


def check(scans: list[Scan]) -> None:
    """What is read is what was written."""
    for scan in scans:
        k = (scan.stamp_ns - T0) // GAP
        np.testing.assert_array_equal(scan.ranges_m, np.array(ranges(k), np.float32))


def text_of(findings: Findings) -> str:
    return next(f.text for code, f in findings if code == "salvaged")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("keep", [0.25, 0.6, 0.95])
def test_a_cut_bag_gives_what_came_before_the_cut(
    tmp_path: Path, bags: dict[str, Path], kind: str, keep: float
) -> None:
    data = bags[kind].read_bytes()
    path = tmp_path / bags[kind].name
    path.write_bytes(data[: int(len(data) * keep)])
    scans, findings = read(path)
    check(scans)
    assert len(scans) > COUNT * (keep - 0.25)  # sqlite keeps other things, too
    assert f"salvaged {len(scans)} messages" in text_of(findings) and "cut" in text_of(findings)


@pytest.mark.parametrize("kind", KINDS)
@given(data=st.data())
@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_damage_anywhere_is_a_finding_or_one_line(
    tmp_path: Path, bags: dict[str, Path], kind: str, data: st.DataObject
) -> None:
    whole = bytearray(bags[kind].read_bytes())
    cut = data.draw(st.integers(20, len(whole)))
    for _ in range(data.draw(st.integers(0, 3))):
        at = data.draw(st.integers(16, len(whole) - 1))
        whole[at : at + 4] = data.draw(st.binary(min_size=4, max_size=4))
    path = tmp_path / bags[kind].name
    path.write_bytes(whole[:cut])
    try:
        read(path)
    except MfslamError as error:
        assert str(path) in str(error) and "\n" not in str(error)


@pytest.mark.parametrize("kind", ["bz2", "lz4"])
def test_compressed_chunks_of_ros_1(tmp_path: Path, kind: str) -> None:
    path, store = tmp_path / "log.bag", get_typestore(Stores.ROS1_NOETIC)
    bag = Writer(path)
    bag.set_compression(Writer.CompressionFormat[kind.upper()])
    bag.chunk_threshold = 20_000
    with bag:
        connection = bag.add_connection("/scan", SCAN, typestore=store)
        for _, _, message, time_ns in entries("ros1"):
            bag.write(connection, time_ns, store.serialize_ros1(message, SCAN))
    data = path.read_bytes()
    path.write_bytes(data[: int(0.7 * len(data))])
    scans, _ = read(path)
    check(scans)
    assert len(scans) > 0.5 * COUNT


def test_a_bag_of_several_files_whose_last_is_cut(tmp_path: Path, bags: dict[str, Path]) -> None:
    folder = tmp_path / "log"
    folder.mkdir()
    shutil.copy(bags["mcap"], folder / "log_0.mcap")
    later = [
        ("/scan", SCAN, Make().scan(T0 + k * GAP, ranges(k)), T0 + k * GAP) for k in range(COUNT, 2 * COUNT)
    ]
    second = write_bag(tmp_path / "second", "mcap", later)
    data = next(second.glob("*.mcap")).read_bytes()
    (folder / "log_1.mcap").write_bytes(data[: len(data) // 2])
    scans, findings = read(folder)
    check(scans)
    assert len(scans) > 1.3 * COUNT and "log_1.mcap" in text_of(findings)


def test_messages_in_an_sqlite_journal_are_read(tmp_path: Path, bags: dict[str, Path]) -> None:
    """As after a power cut: the recorder never came to merge its journal into the file."""
    source = tmp_path / "source.db3"
    shutil.copy(bags["sqlite3"], source)
    database = sqlite3.connect(source)
    database.execute("PRAGMA journal_mode=WAL")
    database.execute("PRAGMA wal_autocheckpoint=0")
    row = database.execute("SELECT topic_id, data FROM messages LIMIT 1").fetchone()
    database.execute(
        "INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)",
        (row[0], T0 + COUNT * GAP, row[1]),
    )
    database.commit()
    path = tmp_path / "cut.db3"
    for suffix in ("", "-wal"):
        shutil.copy(f"{source}{suffix}", f"{path}{suffix}")
    database.close()
    before = path.read_bytes()
    _, findings = read(path)
    assert f"salvaged {COUNT + 1} messages" in text_of(findings) and "journal" in text_of(findings)
    assert path.read_bytes() == before


def test_a_folder_without_metadata(tmp_path: Path, bags: dict[str, Path]) -> None:
    folder = tmp_path / "log"
    folder.mkdir()
    shutil.copy(bags["sqlite3"], folder / "log_0.db3")
    scans, findings = read(folder)
    assert len(scans) == COUNT and "no-metadata" in findings and "salvaged" not in findings


def test_a_bag_is_read_on_after_a_damaged_chunk(tmp_path: Path) -> None:
    """Its index is whole, so that it opens; the damage shows on the way."""
    path, store = tmp_path / "log.bag", get_typestore(Stores.ROS1_NOETIC)
    bag = Writer(path)
    bag.set_compression(Writer.CompressionFormat.BZ2)
    bag.chunk_threshold = 10_000
    with bag:
        connection = bag.add_connection("/scan", SCAN, typestore=store)
        for _, _, message, time_ns in entries("ros1"):
            bag.write(connection, time_ns, store.serialize_ros1(message, SCAN))
    data = bytearray(path.read_bytes())
    data[len(data) // 2 : len(data) // 2 + 8] = bytes(8)
    path.write_bytes(data)
    scans, findings = read(path)
    check(scans)
    assert 0.8 * COUNT < len(scans) < COUNT and "cannot be unpacked" in text_of(findings)
    assert np.all(np.diff([s.stamp_ns for s in scans]) > 0)
    assert "messages-missing" in findings


def test_nothing_to_salvage_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    path.write_bytes(b"\x89MCAP0\r\n" + b"\x00" * 100)
    with pytest.raises(MfslamError, match=r"no message could be salvaged: .+$"):
        open_log(path, Config())


def test_an_old_recording_whose_index_is_wrong(shared_data: Path) -> None:
    scans, findings = read(shared_data / "rosbags" / "scan_tools_laser_scan_matcher_demo.bag")
    assert len(scans) == 360 and {scan.ranges_m.size for scan in scans} == {681}
    assert np.all(np.diff([scan.stamp_ns for scan in scans]) > 0)
    assert "index is missing or wrong" in text_of(findings)
