"""Messages of a ROS bag of any kind, through rosbags, with its errors told in one line each.

On damaged bytes rosbags and the parsers below it raise anything from struct.error to MemoryError: around
calls to them, and only there, every Exception is taken for damage.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from rosbags.highlevel import AnyReader
from rosbags.interfaces import Connection
from rosbags.rosbag2 import ReaderError
from rosbags.typesys import Stores, get_typestore

from drivers.salvage import SalvagedBag, salvage
from drivers.salvage.sqlite import has_journal
from mfslam.types import Findings, MfslamError


class BagReader:
    """An open bag. Raises MfslamError where it cannot be opened."""

    def __init__(self, path: Path, findings: Findings) -> None:
        self.path = path
        self._findings = findings
        self._stack = ExitStack()
        self.last_bag_time_ns = 0
        with self._told_in_one_line():
            self._files = self._found_files()
            self._reader = self._opened()
            self.connections: list[Connection] = list(self._reader.connections)
            self.start_ns, self.end_ns = (
                (self._reader.start_time, self._reader.end_time) if self._reader.message_count else (0, 0)
            )

    def _opened(self) -> AnyReader | SalvagedBag:
        """By its index; where that does not do, by whatever is whole in it."""
        try:
            if any(file.suffix == ".db3" and has_journal(file.resolve()) for file in self._files):
                raise ReaderError("messages lie in a journal beside it")
            # bags that were written without message definitions hold standard messages
            reader = AnyReader(self._files, default_typestore=get_typestore(Stores.LATEST))
            return self._stack.enter_context(reader)
        except Exception:
            found = self._salvaged()
            if found is None:
                raise
            return found

    def _salvaged(self) -> SalvagedBag | None:
        """What is whole in the bag, with a finding; None where that is nothing."""
        found = salvage(
            [path for file in self._files for path in ([file] if file.is_file() else _stored(file))]
        )
        if found is not None:
            self._stack.callback(found.close)
            text = f"salvaged {found.message_count} messages: {found.lost}"
            self._findings.add("salvaged", text, self.path.name)
        return found

    def close(self) -> None:
        self._stack.close()

    def counts(self) -> dict[str, int]:
        """Messages per topic."""
        out: dict[str, int] = {}
        for connection in self.connections:
            out[connection.topic] = out.get(connection.topic, 0) + connection.msgcount
        return dict(sorted(out.items()))

    def messages(self, connections: Sequence[Connection]) -> Iterator[tuple[str, int, Any]]:
        """(topic, bag time in ns, message) in the bag's order. Messages that cannot be decoded are counted.

        A bag that turns out to be damaged is read on as far as it is whole, with findings; if nothing at all
        could be read of it, that is an MfslamError.
        """
        if not connections:
            return
        n_read, time_ns = 0, -1
        source: Iterator[tuple[Connection, int, bytes]] = self._reader.messages(connections=connections)
        while True:
            try:
                connection, time_ns, raw = next(source)
            except StopIteration:
                missing = sum(c.msgcount for c in connections) - n_read
                if missing > 0:
                    text = "message that the bag's index counts is not in the bag"
                    self._findings.add("messages-missing", text, self.path.name, missing)
                return
            except Exception as error:
                rest = self._rest(connections, time_ns)
                if rest is not None:
                    source = rest
                    continue
                if not n_read:
                    raise MfslamError(f"{self.path}: cannot be read: {_first_line(error)}") from None
                text = f"the bag is damaged ({_first_line(error)}): read up to there"
                self._findings.add("file-damaged", text, f"{time_ns} ns")
                return
            n_read += 1
            self.last_bag_time_ns = max(self.last_bag_time_ns, time_ns)
            try:
                message = self._reader.deserialize(raw, connection.msgtype)
            except Exception:
                text = f"message of {connection.topic} cannot be decoded: left out"
                self._findings.add(f"undecodable-{connection.topic}", text, f"{time_ns} ns")
                continue
            yield connection.topic, time_ns, message

    def _rest(
        self, connections: Sequence[Connection], time_ns: int
    ) -> Iterator[tuple[Connection, int, bytes]] | None:
        """What can be salvaged of the messages after ``time_ns``; None where that was tried already."""
        found = None if isinstance(self._reader, SalvagedBag) else self._salvaged()
        if found is None:
            return None
        self._reader = found
        return (entry for entry in found.messages(connections) if entry[1] > time_ns)

    def _found_files(self) -> list[Path]:
        """What rosbags is to open: it goes by suffix, we go by content."""
        if not self.path.is_dir():
            return [self._with_suffix(self.path)]
        if (self.path / "metadata.yaml").is_file():
            return [self.path]
        bare = _stored(self.path)
        self._findings.add(
            "no-metadata", "the bag's folder has no metadata.yaml: its files are read as they are"
        )
        return [self._with_suffix(p) for p in bare]

    def _with_suffix(self, path: Path) -> Path:
        """The file, or a link to it that has the suffix of what is in it."""
        with path.open("rb") as file:
            magic = file.read(16)
        suffix = ".bag" if magic.startswith(b"#ROSBAG") else ".mcap" if b"MCAP" in magic else ".db3"
        if path.suffix == suffix:
            return path
        folder = Path(self._stack.enter_context(tempfile.TemporaryDirectory(prefix="mfslam-")))
        link = folder / (path.name + suffix)
        link.symlink_to(path.resolve())
        return link

    @contextmanager
    def _told_in_one_line(self) -> Iterator[None]:
        try:
            yield
        except Exception as error:
            self._stack.close()
            raise MfslamError(
                f"{self.path}: this bag cannot be opened, and no message could be salvaged: {_first_line(error)}"
            ) from None


def _stored(folder: Path) -> list[Path]:
    """The recordings of a ROS 2 bag's folder."""
    return sorted(path for path in folder.iterdir() if path.suffix in (".mcap", ".db3"))


def _first_line(error: BaseException) -> str:
    return next(iter(str(error).splitlines()), "") or type(error).__name__
