"""A simulated device's end of a pseudo-terminal: a port with a name of its own, that can be unplugged."""

from __future__ import annotations

import contextlib
import fcntl
import os
import pty
import struct
import tty
from pathlib import Path

_TCGETS2 = 0x802C542A  # Linux: termios with any bit rate
_TERMIOS2 = struct.Struct("IIII20sII")


class PtyPort:
    """A pseudo-terminal behind the link ``path``, which stays the same however often it is plugged in."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._ours = self._theirs = -1
        self.plug_in()

    @property
    def plugged_in(self) -> bool:
        return self._ours >= 0

    def plug_in(self) -> None:
        self._ours, self._theirs = pty.openpty()
        tty.setraw(self._theirs)
        os.set_blocking(self._ours, False)
        aside = self.path.with_name(self.path.name + ".new")
        aside.symlink_to(os.ttyname(self._theirs))
        aside.replace(self.path)

    def unplug(self) -> None:
        """The link is gone; whoever has the port open is told by an input/output error."""
        with contextlib.suppress(FileNotFoundError):
            self.path.unlink()
        for fd in (self._ours, self._theirs):
            os.close(fd)
        self._ours = self._theirs = -1

    def fileno(self) -> int:
        return self._ours

    def read(self) -> bytes:
        """What the host has sent; b"" for nothing."""
        with contextlib.suppress(BlockingIOError):
            return os.read(self._ours, 4096)
        return b""

    def write(self, data: bytes) -> bytes:
        """Send; returns what does not fit at present."""
        with contextlib.suppress(BlockingIOError):
            return data[os.write(self._ours, data) :]
        return data

    def host_baud(self) -> int | None:
        """The bit rate that the host has set, None where the system does not tell."""
        try:
            told = fcntl.ioctl(self._theirs, _TCGETS2, bytes(_TERMIOS2.size))
        except OSError:
            return None
        return int(_TERMIOS2.unpack(told)[6])
