"""The registry of log formats: tell them apart by their content, and open them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

from drivers.base import Log, NoScans, TopicChoice
from drivers.carmen_format import SCANS, WORDS, preset_for
from drivers.text_source import TextSource
from mfslam.config import Config
from mfslam.types import MfslamError

LogKind = Literal["carmen", "urg-text", "ros1", "ros2"]

_HEAD_BYTES = 1 << 19
_KNOWN = "CARMEN text, urg-text, a ROS 1 .bag, a ROS 2 bag folder, .db3 or .mcap file"
_URG_TEXT_FIELDS = 700  # a line with so many numbers is one, even if it is cut
_SQLITE_MAGIC, _MCAP_MAGIC, _ROS1_MAGIC = b"SQLite format 3\x00", b"\x89MCAP0", b"#ROSBAG V"


def open_log(path: Path | str, config: Config, *, topics: TopicChoice | None = None) -> Log:
    """The reader that fits a log, whatever its name: a context manager that yields messages.

    Raises MfslamError (one line) for what is missing, empty, unknown or damaged, and `NoScans` for a log
    without scans: here where that can be told at once, else at the end of the iteration.
    """
    path = Path(path)
    kind = detect(path)
    with _readable(path):
        if kind == "carmen":
            from drivers.carmen import CarmenLog

            return CarmenLog(path, config, topics)
        if kind == "urg-text":
            from drivers.urg_text import UrgTextLog

            return UrgTextLog(path, config, topics)
        from drivers.ros_bag import RosBagLog

        return RosBagLog(path, kind, config, topics)


def default_presets(path: Path | str) -> list[str]:
    """Names of the presets that fit a log when the user names none; the first is the lowest layer."""
    path = Path(path)
    kind = detect(path)
    if kind == "urg-text":
        return ["urg-04lx", "urg-text-robot"]
    if kind == "carmen":
        return [_carmen_preset(path)]
    return ["generic"]


def detect(path: Path) -> LogKind:
    """The format of a log, by its first bytes. Raises MfslamError in one line where there is none."""
    with _readable(path):
        if not path.exists():
            raise MfslamError(f"{path}: no such file or folder")
        if path.is_dir():
            if (path / "metadata.yaml").is_file() or bare_files(path):
                return "ros2"
            raise MfslamError(
                f"{path}: a folder that is no ROS 2 bag (no metadata.yaml, .mcap or .db3 in it)"
            )
        with path.open("rb") as file:
            magic = file.read(16)
        if not magic:
            raise MfslamError(f"{path}: the file is empty")
        if magic.startswith(_ROS1_MAGIC):
            return "ros1"
        if magic.startswith((_SQLITE_MAGIC, _MCAP_MAGIC)):
            return "ros2"
        return _detect_text(path)


def bare_files(folder: Path) -> list[Path]:
    """Recordings in a folder without metadata.yaml, in order of their names."""
    return sorted(p for p in folder.iterdir() if p.suffix in (".mcap", ".db3") and p.is_file())


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise MfslamError(f"{path}: cannot be read: {error.strerror or error}") from None


def _detect_text(path: Path) -> LogKind:
    source = TextSource(path)
    head = source.head(_HEAD_BYTES)
    if b"\x00" in head:
        raise MfslamError(f"{path}: binary data, and no log that mfslam reads (known: {_KNOWN})")
    lines = [fields for line in head.splitlines() if (fields := line.split()) and fields[0][:1] != b"#"]
    for fields in lines:
        if fields[0] in WORDS:
            return "carmen"
        if len(fields) >= _URG_TEXT_FIELDS and fields[0].isdigit():
            return "urg-text"
    if source.damage and not lines:
        raise MfslamError(f"{path}: {source.damage}: nothing could be read")
    if not lines and (b"CARMEN" in head or b"message_name" in head or not head.strip()):
        raise NoScans(f"{path}: no scans in it: it holds no line of data")
    raise MfslamError(f"{path}: no log that mfslam reads (known: {_KNOWN})")


def _carmen_preset(path: Path) -> str:
    """CARMEN does not name its laser; the number of beams, the type or the field of view does."""
    for line in TextSource(path).head(_HEAD_BYTES).splitlines():
        fields = line.split(None, 9)
        layout = SCANS.get(fields[0]) if fields else None
        if layout is None or len(fields) <= layout.count_at:
            continue
        try:
            return preset_for(fields, layout)
        except ValueError:
            continue
    return "sick-lms200"
