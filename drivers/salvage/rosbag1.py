"""ROS 1 bags (format 2.0) from their chunks alone: without an index, with a wrong one, or cut off."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import IO

from rosbags.interfaces import Connection, ConnectionExtRosbag1, MessageDefinition, MessageDefinitionFormat
from rosbags.typesys.msg import normalize_msgtype

from drivers.salvage.bag import Contents, Entry, part_of_file, plain

_MESSAGE, _INDEX, _CHUNK, _CONNECTION = 2, 4, 5, 7
_OPS = {2, 3, 4, 5, 6, 7}
_U32, _TIME = struct.Struct("<I"), struct.Struct("<II")
_LONGEST_HEADER = 1 << 16
_Header = dict[bytes, bytes]


def read_rosbag1(path: Path) -> Contents:
    """Everything that is whole in the file."""
    found = Contents(ros2=False)
    with path.open("rb") as file:
        file.readline()
        while (record := _next(file)) is not None:
            header, start, length = record
            op = header[b"op"][0]
            if op == _CHUNK:
                data = file.read(length)
                if len(data) < length:
                    found.lost.append(f"the last chunk is cut after {len(data)} of its {length} bytes")
                _chunk(found, path, header, start, data)
            elif op == _CONNECTION:
                _connection(found, header, file.read(length))
            elif op == _MESSAGE:
                found.pieces.append(partial(part_of_file, path, start, length))
                _message(found, header, len(found.pieces) - 1, 0, length)
            # some writers state more than the 12 bytes per entry that an index has
            skipped = 12 * _U32.unpack(header[b"count"])[0] if op == _INDEX else length
            file.seek(start + skipped)
        file.seek(0, 2)
    found.lost.insert(0, "the bag's index is missing or wrong: its chunks were read one after the other")
    return found


def _next(file: IO[bytes]) -> tuple[_Header, int, int] | None:
    """Header, place and length of the next record's data; None at the end, or where the file is damaged."""
    size = file.read(4)
    if len(size) < 4 or (n := _U32.unpack(size)[0]) > _LONGEST_HEADER:
        return None
    raw = file.read(n)
    length = file.read(4)
    header = _fields(raw)
    if len(raw) < n or len(length) < 4 or header is None or header.get(b"op", b"\x00")[0] not in _OPS:
        return None
    if header[b"op"][0] == _INDEX and len(header.get(b"count", b"")) != 4:
        return None
    return header, file.tell(), _U32.unpack(length)[0]


def _fields(raw: bytes) -> _Header | None:
    out: _Header = {}
    at = 0
    while at + 4 <= len(raw):
        n = _U32.unpack_from(raw, at)[0]
        name, equals, value = raw[at + 4 : at + 4 + n].partition(b"=")
        at += 4 + n
        if not equals or not value or at > len(raw):
            return None
        out[name] = value
    return out


def _chunk(found: Contents, path: Path, header: _Header, start: int, data: bytes) -> None:
    compression = header.get(b"compression", b"none").decode("ascii", "replace")
    try:
        inside = plain(data, compression)
    except ValueError as error:
        found.lost.append(f"a chunk cannot be unpacked ({error})")
        return
    found.pieces.append(partial(_unpacked, path, start, len(data), compression))
    for record_header, at, length in _records(inside):
        if record_header[b"op"][0] == _CONNECTION:
            _connection(found, record_header, inside[at : at + length])
        elif record_header[b"op"][0] == _MESSAGE:
            _message(found, record_header, len(found.pieces) - 1, at, length)


def _unpacked(path: Path, start: int, length: int, compression: str) -> bytes:
    return plain(part_of_file(path, start, length), compression)


def _records(data: bytes) -> Iterator[tuple[_Header, int, int]]:
    """Whole records inside a chunk."""
    at = 0
    while at + 4 <= len(data):
        n = _U32.unpack_from(data, at)[0]
        header = _fields(data[at + 4 : at + 4 + n])
        start = at + 8 + n
        if header is None or b"op" not in header or start > len(data):
            return
        length = _U32.unpack_from(data, start - 4)[0]
        if start + length > len(data):
            return
        yield header, start, length
        at = start + length


def _message(found: Contents, header: _Header, piece: int, at: int, length: int) -> None:
    if len(header.get(b"conn", b"")) != 4 or len(header.get(b"time", b"")) != 8:
        return
    seconds, nanoseconds = _TIME.unpack(header[b"time"])
    connection = _U32.unpack(header[b"conn"])[0]
    if connection in found.connections:
        found.entries.append(Entry(seconds * 1_000_000_000 + nanoseconds, connection, piece, at, at + length))


def _connection(found: Contents, header: _Header, data: bytes) -> None:
    told = _fields(data)
    if (
        told is None
        or not {b"type", b"message_definition"} <= told.keys()
        or len(header.get(b"conn", b"")) != 4
    ):
        return
    number = _U32.unpack(header[b"conn"])[0]
    text = told[b"message_definition"].decode("utf-8", "replace")
    topic = header.get(b"topic", told.get(b"topic", b"")).decode("utf-8", "replace")
    kind = normalize_msgtype(told[b"type"].decode("utf-8", "replace"))
    definition = MessageDefinition(MessageDefinitionFormat.MSG, text)
    found.connections.setdefault(
        number,
        Connection(
            number, f"/{topic.strip('/')}", kind, definition, "", 0, ConnectionExtRosbag1(None, None), None
        ),
    )
