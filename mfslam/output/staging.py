"""Write aside, then rename: a file of a run is either whole and new, or as it was before."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import IO, Self

from mfslam.types import MfslamError

PART_SUFFIX = ".mfslam-part"


class Staging:
    """Collects the files of one folder and puts them in place together, when the block ends well.

    Every file is first written whole under a temporary name in the same folder. An exception inside the
    block (a full disk, Ctrl-C) removes those and leaves the folder as it was.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._parts: dict[Path, Path] = {}

    def __enter__(self) -> Self:
        return self

    @contextmanager
    def open(self, name: str) -> Iterator[IO[bytes]]:
        """A binary file to write; it takes the place of ``name`` when the staging block ends."""
        final = self.folder / name
        part = final.with_name(f".{final.name}{PART_SUFFIX}")
        self._parts[part] = final
        try:
            with part.open("wb") as file:
                yield file
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise cannot_write(final, error) from None

    def write_text(self, name: str, text: str) -> None:
        with self.open(name) as file:
            file.write(text.encode("utf-8"))

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is None:
                for part, final in self._parts.items():
                    part.replace(final)
        except OSError as failure:
            raise cannot_write(self.folder, failure) from None
        finally:
            for part in self._parts:
                part.unlink(missing_ok=True)


def cannot_write(path: Path, error: OSError) -> MfslamError:
    """The one line for a write that failed: what, why, what to do."""
    why = (error.strerror or str(error)).lower()
    full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
    what_to_do = "free some space or choose another place" if full else "choose another place"
    return MfslamError(f"{path}: cannot be written: {why}; {what_to_do}")


def write_atomically(path: Path, data: bytes) -> None:
    """Write one file whole or not at all.

    Raises MfslamError when the disk or its permissions refuse.
    """
    with Staging(path.parent) as staging, staging.open(path.name) as file:
        file.write(data)


def check_outputs(*paths: Path | None) -> None:
    """Find out before the work whether every file that is asked for can be written, each to a place of its own."""
    asked = [path for path in paths if path is not None]
    for n, path in enumerate(asked):
        check_writable(path)
        if path.resolve() in (other.resolve() for other in asked[:n]):
            raise MfslamError(f"{path}: two outputs cannot go to one file")


def check_writable(path: Path) -> None:
    """Find out before the work whether a file can be written at its end.

    Raises MfslamError when not.
    """
    if path.is_dir():
        raise MfslamError(f"{path}: expected a file to write, this is a folder")
    probe = path.with_name(f".{path.name}{PART_SUFFIX}")
    try:
        try:
            probe.write_bytes(b"mfslam")
        finally:  # a full disk leaves an empty file
            probe.unlink(missing_ok=True)
    except OSError as error:
        raise cannot_write(path, error) from None
