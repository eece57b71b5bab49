"""MCAP files from their records alone: without footer, without index, or cut in the middle of a chunk."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from functools import partial
from io import BytesIO
from pathlib import Path

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Schema
from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinition, MessageDefinitionFormat

from drivers.salvage.bag import Contents, Entry, part_of_file, plain

_MAGIC_BYTES, _HEAD = 8, struct.Struct("<BQ")
_MESSAGE, _CHUNK = struct.Struct("<HIQQ"), struct.Struct("<QQQI")
_FORMATS = {"ros2msg": MessageDefinitionFormat.MSG, "ros2idl": MessageDefinitionFormat.IDL}
_LAST = {Opcode.DATA_END, Opcode.FOOTER}


def read_mcap(path: Path) -> Contents:
    """Everything that is whole in the file."""
    found, schemas = Contents(ros2=True), dict[int, Schema]()
    size = path.stat().st_size
    at, ended = _MAGIC_BYTES, False
    with path.open("rb") as file:
        while not ended and at + _HEAD.size <= size:
            file.seek(at)
            op, length = _HEAD.unpack(file.read(_HEAD.size))
            start = at + _HEAD.size
            if op == 0 or (op > Opcode.DATA_END and op < 0x80):
                found.lost.append(f"damaged from byte {at} of {size} on")
                break
            if op == Opcode.CHUNK:
                _chunk(found, schemas, path, start, file.read(min(length, size - start)), length)
            elif start + length > size:
                break
            elif op in (Opcode.SCHEMA, Opcode.CHANNEL):
                _describe(found, schemas, op, file.read(length))
            elif op == Opcode.MESSAGE:
                found.pieces.append(partial(part_of_file, path, start, length))
                _message(found, len(found.pieces) - 1, file.read(_MESSAGE.size), 0, length)
            ended = op in _LAST
            at = start + length
    found.lost.insert(
        0, "the recording was cut off: it has no index" if not ended else "its index is damaged"
    )
    return found


def _chunk(
    found: Contents, schemas: dict[int, Schema], path: Path, start: int, data: bytes, length: int
) -> None:
    """Messages of a chunk, as far as it reaches. ``data``: the record from ``start`` on, at most ``length`` bytes."""
    if len(data) < _CHUNK.size + 4:
        return
    _, _, plain_bytes, crc = _CHUNK.unpack_from(data)
    (n,) = struct.unpack_from("<I", data, _CHUNK.size)
    head = _CHUNK.size + 4 + n + 8
    compression = data[_CHUNK.size + 4 : head - 8].decode("ascii", "replace")
    whole = len(data) == length
    try:
        inside = plain(data[head:], compression)
    except ValueError as error:
        found.lost.append(f"a chunk cannot be unpacked ({error})")
        return
    if whole and (len(inside) != plain_bytes or (crc and zlib.crc32(inside) != crc)):
        found.lost.append("a chunk whose checksum is wrong is left out")
        return
    if not whole:
        found.lost.append(f"the last chunk is cut after {len(data)} of its {length} bytes")
    found.pieces.append(partial(_unpacked, path, start + head, len(data) - head, compression))
    for op, at, size in _records(inside):
        if op in (Opcode.SCHEMA, Opcode.CHANNEL):
            _describe(found, schemas, op, inside[at : at + size])
        elif op == Opcode.MESSAGE:
            _message(found, len(found.pieces) - 1, inside[at : at + _MESSAGE.size], at, size)


def _unpacked(path: Path, start: int, length: int, compression: str) -> bytes:
    return plain(part_of_file(path, start, length), compression)


def _records(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Opcode, place and length of the whole records inside a chunk."""
    at = 0
    while at + _HEAD.size <= len(data):
        op, length = _HEAD.unpack_from(data, at)
        start = at + _HEAD.size
        if start + length > len(data):
            return
        yield op, start, length
        at = start + length


def _message(found: Contents, piece: int, head: bytes, at: int, length: int) -> None:
    if length < _MESSAGE.size:
        return
    channel, _, log_ns, _ = _MESSAGE.unpack(head)
    if channel in found.connections:
        found.entries.append(Entry(log_ns, channel, piece, at + _MESSAGE.size, at + length))


def _describe(found: Contents, schemas: dict[int, Schema], op: int, data: bytes) -> None:
    stream = ReadDataStream(BytesIO(data))
    if op == Opcode.SCHEMA:
        schema = Schema.read(stream)
        schemas[schema.id] = schema
        return
    channel = Channel.read(stream)
    known = schemas.get(channel.schema_id)
    if known is None or known.encoding not in _FORMATS or channel.message_encoding != "cdr":
        return
    definition = MessageDefinition(_FORMATS[known.encoding], known.data.decode("utf-8", "replace"))
    ext = ConnectionExtRosbag2("cdr", [])
    found.connections[channel.id] = Connection(
        channel.id, channel.topic, known.name, definition, "", 0, ext, None
    )
