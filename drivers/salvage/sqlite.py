"""ROS 2 bags in sqlite3 that were cut off: with a journal that was never merged, or with pages missing."""

from __future__ import annotations

import contextlib
import shutil
import sqlite3
import struct
import tempfile
from collections.abc import Iterator
from pathlib import Path

from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinition, MessageDefinitionFormat
from rosbags.typesys import Stores, get_typestore

from drivers.salvage.bag import Contents, Entry

_JOURNALS = ("-wal", "-journal")
_MISSING = b"\xffmfslam: not in the file\xff"  # stands where pages are missing, so that no row pretends


_LARGEST = 1000  # times the file's size: more cannot be missing


def has_journal(path: Path) -> bool:
    """Whether messages lie beside the file, in a journal that was never merged into it."""
    return any(_size(Path(f"{path}{suffix}")) for suffix in _JOURNALS)


def read_sqlite(path: Path) -> Contents:
    """Every row that can be read. The file itself is not touched: sqlite repairs a copy."""
    found = Contents(ros2=True)
    merged = has_journal(path)
    with tempfile.TemporaryDirectory(prefix="mfslam-") as folder:
        copy = Path(folder) / "copy.db3"
        shutil.copyfile(path, copy)
        for suffix in _JOURNALS:
            if _size(Path(f"{path}{suffix}")):
                shutil.copyfile(f"{path}{suffix}", f"{copy}{suffix}")
        missing = _fill_up(copy)
        with contextlib.closing(sqlite3.connect(copy)) as database:
            try:
                _topics(found, database)
                rows = {row[0]: row for row in _rows(database)}
            except sqlite3.Error:
                return found
    blobs: list[bytes] = []
    for _, topic, time_ns, data in sorted(rows.values()):
        if topic in found.connections and _MISSING not in data:
            found.entries.append(Entry(time_ns, topic, len(blobs), 0, len(data)))
            blobs.append(data)
    found.pieces = [lambda data=data: data for data in blobs]  # type: ignore[misc]
    if merged:
        found.lost.append("the recording was cut off: what lay in its journal was read, too")
    if missing:
        found.lost.append(f"the file is cut off: {missing} bytes of it are missing")
    if not found.lost:
        found.lost.append("the database is damaged: only some of its rows could be read")
    return found


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


def _rows(database: sqlite3.Connection) -> Iterator[tuple[int, int, int, bytes]]:
    """Rows from the front until one cannot be read, then from the back."""
    for order in ("ASC", "DESC"):
        try:
            yield from database.execute(
                f"SELECT id, topic_id, timestamp, data FROM messages ORDER BY id {order}"
            )
        except sqlite3.DatabaseError:
            continue
        return
