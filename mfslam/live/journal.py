"""What goes to the back end, in order, on disk: the queue to it, and all that a new one needs when it has died."""

from __future__ import annotations

import os
import pickle
import tempfile
import threading
from pathlib import Path
from typing import Any

from mfslam.types import MfslamError

_LENGTH = 8  # bytes


class Journal:
    """An append-only file without a name: it is gone with the process, however that ends."""

    def __init__(self, folder: Path | None) -> None:
        self._file = tempfile.TemporaryFile(dir=folder, buffering=0)  # noqa: SIM115 it lives as long as we do
        self._fd = self._file.fileno()
        self.size = 0
        self._grown = threading.Condition()

    def append(self, item: Any) -> None:
        """Keep an item. Raises MfslamError when the disk is full."""
        data = pickle.dumps(item, protocol=pickle.HIGHEST_PROTOCOL)
        record = len(data).to_bytes(_LENGTH, "little") + data
        try:
            if self._file.write(record) != len(record):
                raise OSError
        except OSError as error:
            raise MfslamError(
                f"the journal of the live map cannot be written ({(error.strerror or 'no space left on device').lower()}): "
                "free some disk, or set TMPDIR to another one"
            ) from None
        with self._grown:
            self.size += len(record)
            self._grown.notify()

    def wait_beyond(self, offset: int, timeout_s: float) -> bool:
        """Whether there is something at ``offset``, by then."""
        with self._grown:
            return self._grown.wait_for(lambda: self.size > offset, timeout_s)

    def read(self, offset: int) -> tuple[bytes, int]:
        """The record at ``offset``, pickled, and where the next one begins."""
        length = int.from_bytes(os.pread(self._fd, _LENGTH, offset), "little")
        return os.pread(self._fd, length, offset + _LENGTH), offset + _LENGTH + length

    def wake(self) -> None:
        with self._grown:
            self._grown.notify()

    def close(self) -> None:
        self._file.close()
