"""What is no log gets one clear line."""

from __future__ import annotations

import gzip
import os

import pytest
from log_lines import flaser

from drivers.base import NoScans
from drivers.logs import detect, open_log
from mfslam.config import Config
from mfslam.types import MfslamError

CASES = {
    "empty.clf": (b"", "the file is empty"),
    "binary.log": (bytes(range(256)) * 40, "binary data, and no log that mfslam reads"),
    "binary.log.gz": (gzip.compress(os.urandom(64) + b"\x00" * 3000), "binary data"),
    "essay.txt": (b"It was a dark night.\nThe robot slept.\n", "no log that mfslam reads"),
    "numbers.txt": (b"1 2 3\n4 5 6\n", "no log that mfslam reads"),
    "cut.clf.gz": (gzip.compress(os.urandom(20000))[:12], "nothing could be read"),
    "stub.bag": (b"#ROSBAG V2.0\n\x45\x00", "this bag cannot be opened"),
    "stub.mcap": (b"\x89MCAP0\r\n" + b"\x01" * 50, "this bag cannot be opened"),
    "stub.db3": (b"SQLite format 3\x00" + b"\x00" * 500, "this bag cannot be opened"),
}


@pytest.mark.parametrize("name", CASES)
def test_bad_file(tmp_path, name):
    content, message = CASES[name]
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(MfslamError) as caught, open_log(path, Config()) as log:
        list(log)
    text = str(caught.value)
    assert message in text and str(path) in text and "\n" not in text


def test_missing_and_folder(tmp_path):
    with pytest.raises(MfslamError, match="no such file or folder"):
        open_log(tmp_path / "nowhere.clf", Config())
    with pytest.raises(MfslamError, match="a folder that is no ROS 2 bag"):
        open_log(tmp_path, Config())
    (tmp_path / "metadata.yaml").write_text("rosbag2_bagfile_information: {version: 4}\n")
    with pytest.raises(MfslamError, match="this bag cannot be opened"):
        open_log(tmp_path, Config())


def test_header_only_log_has_no_scans(tmp_path):
    (tmp_path / "a.clf").write_text("# CARMEN Logfile\n# message_name [message contents]\n")
    with pytest.raises(NoScans):
        open_log(tmp_path / "a.clf", Config())


@pytest.mark.parametrize("name", ["log", "log.bag", "log.dat", "log.gz"])
def test_content_counts_not_the_name(tmp_path, name):
    path = tmp_path / name
    path.write_text("# some words\n\nPARAM robot_length 1 1 h 1\n" + flaser(1, [1.0] * 180, (0, 0, 0)) + "\n")
    assert detect(path) == "carmen"
