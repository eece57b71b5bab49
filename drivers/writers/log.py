"""One function that writes any log, chosen by format or suffix, whole or not at all."""

from __future__ import annotations

import shutil
import sqlite3
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Literal, get_args

from mfslam.config import WheelsConfig
from mfslam.types import Findings, Message, MfslamError

Format = Literal["carmen", "urg-text", "ros1", "ros2-sqlite3", "ros2-mcap"]
FORMATS: tuple[str, ...] = get_args(Format)
_BY_SUFFIX: dict[str, Format] = {
    ".clf": "carmen",
    ".log": "carmen",
    ".dat": "urg-text",
    ".bag": "ros1",
    ".db3": "ros2-sqlite3",
    ".mcap": "ros2-mcap",
}


def write_log(
    messages: Iterable[Message],
    path: Path | str,
    format: str | None = None,
    *,
    wheels: WheelsConfig | None = None,
    overwrite: bool = False,
) -> Findings:
    """Write messages, in their order, as one log; returns what the format could not hold, counted.

    ``format``: one of FORMATS; by default from the suffix (.clf, .log, .dat, .bag, .db3, .mcap; text also
    with .gz or .bz2; none: a folder with MCAP). A ROS 2 format makes a bag folder, or the bare file when the path ends in .db3 or
    .mcap. ``wheels``: ticks per turn (for bags of encoder ticks) and order of the sides (for URG text).
    Raises MfslamError when the format cannot hold the log, or the path exists and is not to be overwritten.
    """
    path = Path(path)
    kind = format_of(path, format)
    if path.exists() and not overwrite:
        raise MfslamError(f"{path}: exists already; choose another name or allow overwriting")
    findings = Findings()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".writing-", dir=path.parent) as aside:
            written = _write(messages, Path(aside), path, kind, findings, wheels)
            if path.is_dir():
                shutil.rmtree(path)
            written.replace(path)
    except (OSError, sqlite3.Error) as error:  # a full disk, for one
        reason = getattr(error, "strerror", None) or error
        raise MfslamError(f"{path}: cannot be written: {reason}") from None
    return findings


def log_stem(path: Path) -> str:
    """The name of a log without what tells its format and compression."""
    name = path.name
    while Path(name).suffix in (*_BY_SUFFIX, ".gz", ".bz2"):
        name = Path(name).stem
    return name


def format_of(path: Path, format: str | None = None) -> Format:
    """The format that is named, else that of the suffix. Raises MfslamError where there is none."""
    if format is None:
        if not path.suffix:
            return "ros2-mcap"
        suffixes = [s for s in path.suffixes if s in _BY_SUFFIX]
        if not suffixes:
            raise MfslamError(
                f"{path}: no log format known by this suffix; use one of {', '.join(_BY_SUFFIX)} "
                f"or name a format: {', '.join(FORMATS)}"
            )
        return _BY_SUFFIX[suffixes[-1]]
    for known in get_args(Format):
        if format == known:
            return known  # type: ignore[no-any-return]
    raise MfslamError(f"no log format {format!r}; known: {', '.join(FORMATS)}")


def _write(
    messages: Iterable[Message],
    aside: Path,
    path: Path,
    kind: Format,
    findings: Findings,
    wheels: WheelsConfig | None,
) -> Path:
    target = aside / "log"
    if kind in ("carmen", "urg-text"):
        from drivers.writers.carmen import write_carmen
        from drivers.writers.text import text_sink
        from drivers.writers.urg_text import write_urg_text

        with text_sink(target, path.suffix) as out:
            if kind == "carmen":
                write_carmen(messages, out, findings)
            else:
                write_urg_text(messages, out, findings, wheels is not None and wheels.swap_sides)
        return target
    if kind == "ros1":
        from drivers.writers.ros1 import write_ros1

        write_ros1(messages, target, findings, wheels)
        return target
    from drivers.writers.ros2 import write_ros2

    folder = aside / path.name  # rosbags names the storage file, and metadata.yaml it, after the folder
    write_ros2(messages, folder, findings, "mcap" if kind == "ros2-mcap" else "sqlite3", wheels)
    if path.suffix in (".mcap", ".db3"):
        return next(folder.glob(f"*{path.suffix}"))
    return folder
