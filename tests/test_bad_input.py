"""Every kind of broken input gives one clear line and nothing on disk, or a map and a counted warning."""

from __future__ import annotations

import gzip
import json
import random
import resource
from collections.abc import Callable
from pathlib import Path

import pytest
from short_logs import carmen_lines

from mfslam.cli import main

Lines = list[str]


@pytest.fixture(scope="module")
def lines(tmp_path_factory: pytest.TempPathFactory) -> Lines:
    return carmen_lines(tmp_path_factory.mktemp("drive"))


def edited(line: str, start: int, *fields: str) -> str:
    """``line`` with fields from ``start`` on (negative: from the end) replaced."""
    parts = line.split()
    start = start if start >= 0 else len(parts) + start
    parts[start : start + len(fields)] = fields
    return " ".join(parts)


def with_ranges(line: str, ranges: list[str]) -> str:
    parts = line.split()
    return " ".join(["FLASER", str(len(ranges)), *ranges, *parts[2 + int(parts[1]) :]])


def every(lines: Lines, step: int, change: Callable[[str], str]) -> Lines:
    return [change(line) if n % step == step - 1 else line for n, line in enumerate(lines)]


# --- refused: one line, exit 1, nothing on disk ------------------------------------------------------


def noise(size: int) -> bytes:
    return random.Random(1).randbytes(size)


REFUSED: dict[str, tuple[bytes | None, str]] = {
    "missing.log": (None, "no such file or folder"),
    "empty.log": (b"", "the file is empty"),
    "binary.log": (noise(20_000), "binary data, and no log that mfslam reads"),
    "image.log": (b"\x89PNG\r\n\x1a\n" + noise(500), "binary data, and no log that mfslam reads"),
    "diary.log": (b"Dear diary,\ntoday it rained.\n" * 50, "no log that mfslam reads (known: CARMEN text"),
    "odometry.log": (b"ODOM 0 0 0 0 0 0 1.0 h 1.0\n" * 9, "no scans in it (expected FLASER"),
    "fields.log": (b"FLASER 99999999999 1.0 0 0 0 0 0 0 1 h 1\n" * 9, "no usable scan in it"),
    "cut.log.gz": (gzip.compress(noise(900))[:15], "nothing could be read"),
    "junk.bag": (b"#ROSBAG V2.0\n" + noise(3000), "cannot be opened"),
    "junk.mcap": (b"\x89MCAP0\r\n" + noise(3000), "cannot be opened"),
    "junk.db3": (b"SQLite format 3\x00" + noise(3000), "cannot be opened"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_no_log_is_one_line(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content, expected = REFUSED[name]
    if content is not None:
        (tmp_path / name).write_bytes(content)
    out = tmp_path / "deep" / "out"
    for command in (["map", str(tmp_path / name), "-o", str(out), "-q"], ["info", str(tmp_path / name)]):
        assert main(command) == 1
        said = capsys.readouterr()
        assert said.out == ""
        assert said.err.startswith(f"mfslam: {tmp_path / name}: ") and expected in said.err
        assert said.err.count("\n") == 1
    assert not out.parent.exists()


def test_a_folder_that_is_no_bag_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "notes.txt").write_text("nothing")
    assert main(["map", str(tmp_path), "-o", str(tmp_path / "out"), "-q"]) == 1
    assert "a folder that is no ROS 2 bag (no metadata.yaml, .mcap or .db3 in it)" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("reading", ["nan", "0.0", "81.91"])
def test_scans_that_see_nothing_are_one_line(
    lines: Lines, reading: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = write(tmp_path, [with_ranges(line, [reading] * 181) for line in lines[:40]])
    assert main(["map", str(log), "-o", str(tmp_path / "out"), "-q"]) == 1
    assert "none of its 40 scans has a usable range: nothing to map" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


# --- mapped all the same, with a counted warning -----------------------------------------------------

Change = Callable[[Lines], Lines]

ODD: dict[str, tuple[Change, str | None, int, int]] = {
    # name: (what is done to 100 scans, code of the warning, its count, scans left)
    "no odometry": (lambda a: [edited(x, -9, *["0"] * 6) for x in a], "no-odometry", 1, 100),
    "cut lines": (lambda a: every(a, 10, lambda x: x[: len(x) // 2]), "line-garbled", 10, 90),
    "bad ranges": (lambda a: every(a, 5, lambda x: edited(x, 9, "nan", "-3", "inf", "-inf")), "range-invalid", 60, 100),
    "beams change": (
        lambda a: [x if n < 50 else with_ranges(x, x.split()[2:-9][::2]) for n, x in enumerate(a)],
        "laser-changed", 1, 100,
    ),
    "stamps go back": (lambda a: a[:40] + a[59:39:-1] + a[60:], "stamp-backwards", 19, 100),
    "two lasers": (lambda a: [y for x in a for y in (x, x.replace("FLASER", "RLASER"))], "several-lasers", 1, 100),
    "garbled stamps": (lambda a: every(a, 10, lambda x: edited(x, -3, "1e30")), "line-garbled", 10, 90),
    "odometry is nan": (lambda a: every(a, 10, lambda x: edited(x, -9, *["nan"] * 6)), "odometry-invalid", 10, 100),
    "odometry is far": (lambda a: every(a, 50, lambda x: edited(x, -9, *["1e9"] * 6)), "odometry-jump", 3, 100),
    "blind at first": (
        lambda a: [with_ranges(x, ["0.0"] * (len(x.split()) - 11)) if n < 8 else x for n, x in enumerate(a)],
        None, 0, 100,
    ),
    "blind on the way": (
        lambda a: [with_ranges(x, ["0.0"] * (len(x.split()) - 11)) if 40 <= n < 60 else x for n, x in enumerate(a)],
        None, 0, 100,
    ),
    "one scan": (lambda a: a[:1], None, 0, 1),
    "never moves": (lambda a: a[:1] * 60, "stamp-repeated", 59, 60),
    "two beams": (lambda a: [with_ranges(x, ["2.0", "2.1"]) for x in a], "field-of-view-guessed", 1, 100),
}  # fmt: skip


@pytest.mark.parametrize("name", ODD)
def test_odd_logs_are_mapped_and_the_oddity_counted(
    lines: Lines, name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    change, code, count, scans = ODD[name]
    log, out = write(tmp_path, change(list(lines))), tmp_path / "out"
    assert main(["map", str(log), "-o", str(out)]) == 0
    said = capsys.readouterr()
    summary = json.loads((out / "summary.json").read_text())
    assert summary["counts"]["scans"] == scans
    assert summary["map"]["width_m"] < 60.0 and summary["map"]["height_m"] < 60.0
    assert len((out / "trajectory.tum").read_text().splitlines()) >= scans
    counted = {finding["code"]: finding for finding in summary["findings"]}
    if code is not None:
        assert counted[code]["count"] == count
        assert f"note: {counted[code]['text']}" in said.err
        assert counted[code]["text"].split(":")[0].replace("'", "&#39;") in (
            out / "report.html"
        ).read_text().replace("&#x27;", "&#39;")


# --- places that cannot be written -------------------------------------------------------------------


def test_a_limit_on_file_size_leaves_nothing(
    lines: Lines, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, out = write(tmp_path, lines[:20]), tmp_path / "out"
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, hard))
    try:
        assert main(["map", str(log), "-o", str(out), "-q"]) == 1
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert (
        "cannot be written: file too large; free some space or choose another place"
        in capsys.readouterr().err
    )
    assert not out.exists()


@pytest.mark.parametrize("target", ["/proc/out", "log.clf"])
def test_a_place_that_cannot_be_written_is_told_before_the_work(
    lines: Lines, target: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = write(tmp_path, lines)
    assert main(["map", str(log), "-o", str(tmp_path / target)]) == 1
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and ("cannot be written" in said or "expected a folder" in said)


def test_a_json_file_that_cannot_be_written_is_told_before_the_work(
    lines: Lines, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = write(tmp_path, lines)
    nowhere, out = tmp_path / "missing" / "x.json", tmp_path / "out"
    for command in (["map", str(log), "-o", str(out)], ["demo", "-o", str(out)], ["info", str(log)]):
        for target, reason in ((nowhere, "no such file or directory"), (tmp_path, "this is a folder")):
            assert main([*command, "--json", str(target)]) == 1
            said = capsys.readouterr()
            assert said.out == "" and reason in said.err and said.err.count("\n") == 1
    assert not out.exists()


def test_an_old_run_is_kept_unless_told(
    lines: Lines, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, out = write(tmp_path, lines[:20]), tmp_path / "out"
    command = ["map", str(log), "-o", str(out), "-q"]
    assert main(command) == 0
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    assert main([*command, "--set", "map.resolution_m=0.1"]) == 1
    assert "already holds a run; give --overwrite to replace it" in capsys.readouterr().err
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before
    (out / "mine.txt").write_text("kept")
    assert main([*command, "--set", "map.resolution_m=0.1", "--overwrite"]) == 0
    assert (out / "map.pgm").read_bytes() != before["map.pgm"]
    assert (out / "mine.txt").read_text() == "kept"
    assert {path.name for path in out.iterdir()} == {*before, "mine.txt"}


def write(folder: Path, lines: Lines) -> Path:
    log = folder / "log.clf"
    log.write_text("\n".join(lines) + "\n", encoding="ascii")
    return log
