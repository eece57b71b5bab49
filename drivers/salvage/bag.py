"""A bag without a usable index, read from its records; stands in for `rosbags.highlevel.AnyReader`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

from rosbags.interfaces import Connection, MessageDefinitionFormat
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

_PIECES_KEPT = 4


class Entry(NamedTuple):
    """Where a message lies: ``start`` to ``end`` in the plain bytes of a piece (a chunk)."""

    time_ns: int
    connection: int
    piece: int
    start: int
    end: int


@dataclass
class Contents:
    """What was found in a file. ``pieces`` give plain bytes when called, as long as ``resources`` are open;
    ``lost`` says in words what is missing."""

    ros2: bool
    connections: dict[int, Connection] = field(default_factory=dict)
    entries: list[Entry] = field(default_factory=list)
    pieces: list[Callable[[], bytes]] = field(default_factory=list)
    lost: list[str] = field(default_factory=list)
    resources: ExitStack = field(default_factory=ExitStack)


class SalvagedBag:
    """The messages that were found, in order of their bag times."""

    def __init__(self, contents: Contents) -> None:
        self._contents = contents
        counts: dict[int, int] = {}
        for entry in contents.entries:
            counts[entry.connection] = counts.get(entry.connection, 0) + 1
        self.connections = [c._replace(msgcount=counts.get(c.id, 0)) for c in contents.connections.values()]
        contents.entries.sort(key=lambda entry: entry.time_ns)  # stable
        self.message_count = len(contents.entries)
        self.start_time = contents.entries[0].time_ns if contents.entries else 0
        self.end_time = contents.entries[-1].time_ns + 1 if contents.entries else 0
        self.lost = "; ".join(contents.lost)
        self._typestore = _typestore(self.connections, contents.ros2)
        self._piece = lru_cache(maxsize=_PIECES_KEPT)(lambda n: contents.pieces[n]())

    def close(self) -> None:
        self._contents.resources.close()

    def messages(self, connections: Sequence[Connection]) -> Iterator[tuple[Connection, int, bytes]]:
        """As `AnyReader.messages`; connections are told by their topics."""
        topics = {c.topic for c in connections}
        wanted = {c.id: c for c in self.connections if c.topic in topics}
        for entry in self._contents.entries:
            connection = wanted.get(entry.connection)
            if connection is not None:
                yield connection, entry.time_ns, self._piece(entry.piece)[entry.start : entry.end]

    def deserialize(self, raw: bytes, kind: str) -> Any:
        """As `AnyReader.deserialize`."""
        if self._contents.ros2:
            return self._typestore.deserialize_cdr(raw, kind)
        return self._typestore.deserialize_ros1(raw, kind)


def _typestore(connections: Sequence[Connection], ros2: bool) -> Any:
    """Types as the bag defines them, standard ones where it does not (old bags name the Header otherwise)."""
    types: dict[str, Any] = dict(get_typestore(Stores.LATEST if ros2 else Stores.ROS1_NOETIC).fielddefs)
    for connection in connections:
        definition = connection.msgdef
        if definition.format == MessageDefinitionFormat.MSG:
            types.update(get_types_from_msg(definition.data, connection.msgtype))
        elif definition.format == MessageDefinitionFormat.IDL:
            types.update(get_types_from_idl(definition.data))
    store = get_typestore(Stores.EMPTY)
    store.register(types)
    return store


def salvage(paths: Sequence[Path]) -> SalvagedBag | None:
    """What can be read of the damaged files of one bag; None where that is nothing."""
    whole = Contents(ros2=True)
    for path in paths:
        found = _contents(path)
        if found is not None:
            _append(whole, found, path.name if len(paths) > 1 else "")
    if not whole.entries:
        whole.resources.close()
        return None
    return SalvagedBag(whole)


def _contents(path: Path) -> Contents | None:
    with path.open("rb") as file:
        magic = file.read(16)
    if magic.startswith(b"#ROSBAG V2.0"):
        from drivers.salvage.rosbag1 import read_rosbag1 as read
    elif magic.startswith(b"\x89MCAP0"):
        from drivers.salvage.mcap import read_mcap as read
    elif magic.startswith(b"SQLite format 3\x00"):
        from drivers.salvage.sqlite import read_sqlite as read
    else:
        return None
    return read(path)


def _append(whole: Contents, found: Contents, name: str) -> None:
    """Add one file's contents; its numbers go on after those before."""
    piece, number = len(whole.pieces), max(whole.connections, default=-1) + 1
    whole.ros2 = found.ros2
    whole.connections |= {number + k: c._replace(id=number + k) for k, c in found.connections.items()}
    whole.entries += [
        e._replace(connection=e.connection + number, piece=e.piece + piece) for e in found.entries
    ]
    whole.pieces += found.pieces
    whole.resources.enter_context(found.resources)
    whole.lost += [f"{name}: {text}" if name else text for text in found.lost]


def part_of_file(path: Path, start: int, length: int) -> bytes:
    with path.open("rb") as file:
        file.seek(start)
        return file.read(length)


def plain(data: bytes, compression: str) -> bytes:
    """Decompress a chunk; of a cut one as much as there is. ``compression``: "" or "none", bz2, lz4, zstd.

    Raises ValueError for another one or for damaged bytes.
    """
    try:
        if compression == "bz2":
            import bz2

            return bz2.BZ2Decompressor().decompress(data)
        if compression == "lz4":
            import lz4.frame

            return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data))
        if compression == "zstd":
            import zstandard

            return bytes(zstandard.ZstdDecompressor().decompressobj().decompress(data))
    except Exception as error:  # each library has errors of its own
        raise ValueError(f"{compression}: {error}") from None
    if compression not in ("", "none"):
        raise ValueError(f"unknown compression {compression!r}")
    return data
