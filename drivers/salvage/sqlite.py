"""ROS 2 bags in sqlite3 that were cut off: with a journal that was never merged, or with pages missing."""

from __future__ import annotations

import contextlib
import shutil
import sqlite3
import struct
import tempfile
from collections.abc import Iterator
from functools import partial
from pathlib import Path

from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinition, MessageDefinitionFormat
from rosbags.typesys import Stores, get_typestore

from drivers.salvage.bag import Contents, Entry

_JOURNALS = ("-wal", "-journal")
_MISSING = b"\xffmfslam: not in the file\xff"  # stands where pages are missing, so that no row pretends


_LARGEST = 20  # times the file's size: more cannot be missing


def has_journal(path: Path) -> bool:
    """Whether messages lie beside the file, in a journal that was never merged into it."""
    return any(_size(Path(f"{path}{suffix}")) for suffix in _JOURNALS)


def read_sqlite(path: Path) -> Contents:
    """Every row that can be read. The file itself is not touched: sqlite repairs a copy, which lives as long as
    ``resources`` of the contents."""
    found, path = Contents(ros2=True), path.resolve()  # its journal lies beside the file, not beside a link
    folder = Path(found.resources.enter_context(tempfile.TemporaryDirectory(prefix="mfslam-")))
    copy, merged = folder / "copy.db3", has_journal(path)
    shutil.copyfile(path, copy)
    for suffix in _JOURNALS:
        if _size(Path(f"{path}{suffix}")):
            shutil.copyfile(f"{path}{suffix}", f"{copy}{suffix}")
    missing = _fill_up(copy)
    database = found.resources.enter_context(contextlib.closing(sqlite3.connect(copy)))
    try:
        _topics(found, database)
        rows = {row: (topic, time_ns, size) for row, topic, time_ns, size in _rows(database)}
    except sqlite3.Error:
        return found
    for row, (topic, time_ns, size) in sorted(rows.items()):
        if topic in found.connections:
            found.entries.append(Entry(time_ns, topic, len(found.pieces), 0, size))
            found.pieces.append(partial(_blob, database, row))
    if merged:
        found.lost.append("the recording was cut off: what lay in its journal was read, too")
    if missing:
        found.lost.append(f"the file is cut off: {missing} bytes of it are missing")
    if not found.lost:
        found.lost.append("the database is damaged: only some of its rows could be read")
    return found


def _blob(database: sqlite3.Connection, row: int) -> bytes:
    return bytes(database.execute("SELECT data FROM messages WHERE id = ?", (row,)).fetchone()[0])


def _size(path: Path) -> int:
    return path.stat().st_size if path.is_file() else 0


def _fill_up(copy: Path) -> int:
    """Give a cut file the length that its header states, without which sqlite reads none of it."""
    with copy.open("r+b") as file:
        head = file.read(32)
        if len(head) < 32:
            return 0
        told = struct.unpack(">H", head[16:18])[0]
        page_bytes = 65536 if told == 1 else told
        stated = page_bytes * struct.unpack(">I", head[28:32])[0]
        if page_bytes < 512 or stated > _LARGEST * file.seek(0, 2):
            return 0  # this header tells nothing
        size = file.seek(0, 2)
        if size >= stated:
            return 0
        whole = size - size % page_bytes  # half a page is none
        file.seek(whole)
        page = (_MISSING * (page_bytes // len(_MISSING) + 1))[:page_bytes]
        file.write(page * ((stated - whole) // page_bytes))
    return int(stated - size)


def _topics(found: Contents, database: sqlite3.Connection) -> None:
    store = get_typestore(Stores.LATEST)
    definitions: dict[str, str] = {}
    with contextlib.suppress(sqlite3.Error):  # older recordings have none
        query = "SELECT topic_type, encoded_message_definition FROM message_definitions WHERE encoding = 'ros2msg'"
        definitions = dict(database.execute(query).fetchall())
    for number, topic, kind, encoding in database.execute(
        "SELECT id, name, type, serialization_format FROM topics"
    ):
        text = definitions.get(kind)
        if text is None and kind in store.types:
            text = store.generate_msgdef(kind, ros_version=2)[0]
        if text is not None and encoding == "cdr":
            definition = MessageDefinition(MessageDefinitionFormat.MSG, text)
            ext = ConnectionExtRosbag2("cdr", [])
            found.connections[number] = Connection(number, topic, kind, definition, "", 0, ext, None)


def _rows(database: sqlite3.Connection) -> Iterator[tuple[int, int, int, int]]:
    """Number, topic, time and size of the rows from the front until one cannot be read, then from the back."""
    for order in ("ASC", "DESC"):
        try:
            for row, topic, time_ns, data in database.execute(
                f"SELECT id, topic_id, timestamp, data FROM messages ORDER BY id {order}"
            ):
                if _MISSING not in data:
                    yield row, topic, time_ns, len(data)
        except sqlite3.DatabaseError:
            continue
        return
