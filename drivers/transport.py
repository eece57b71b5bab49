"""Byte lines to sensors: serial ports and TCP, with the host's clock that never jumps."""

from __future__ import annotations

import contextlib
import errno
import os
import select
import socket
import time
from pathlib import Path
from typing import Protocol

from mfslam.types import MfslamError

_AT_ONCE = 65536
_CONNECT_S = 3.0


class Unplugged(OSError):
    """The line is gone: cable pulled, device switched off, connection closed."""


class Transport(Protocol):
    """A line that is open. Raises Unplugged from any call once it is gone."""

    def read(self, timeout_s: float) -> bytes:
        """What has come, at least one byte; b"" after ``timeout_s`` without any."""
        ...

    def write(self, data: bytes) -> None: ...

    def set_baud(self, baud: int) -> None:
        """Change the bit rate; nothing where the line has none."""
        ...

    def baud(self) -> int | None:
        """Bit rate of the line, None where it has none."""
        ...

    def now_s(self) -> float:
        """The host's clock, never set: seconds since some start."""
        ...

    def close(self) -> None: ...


class _FileTransport:
    """What is common to everything that has a file descriptor."""

    def __init__(self, fd: int, name: str) -> None:
        self._fd, self._name = fd, name

    def read(self, timeout_s: float) -> bytes:
        try:
            ready, _, _ = select.select([self._fd], [], [], max(0.0, timeout_s))
            if not ready:
                return b""
            data = os.read(self._fd, _AT_ONCE)
        except (OSError, ValueError) as error:
            raise Unplugged(f"{self._name}: {error}") from None
        if not data:
            raise Unplugged(f"{self._name}: closed by the other side")
        return data

    def write(self, data: bytes) -> None:
        try:
            while data:
                data = data[os.write(self._fd, data) :]
        except OSError as error:
            raise Unplugged(f"{self._name}: {error}") from None

    def now_s(self) -> float:
        return time.monotonic()


class SerialTransport(_FileTransport):
    """A serial port, for us alone. Raises Unplugged where it cannot be opened."""

    def __init__(self, path: str, baud: int) -> None:
        import serial

        try:
            # 8N1, no flow control; a second program on the port is refused
            self._port = serial.Serial(path, baud, timeout=0, exclusive=True)
        except (OSError, ValueError) as error:  # SerialException is an OSError
            raise Unplugged(f"{path}: cannot be opened: {_reason(error)}") from None
        super().__init__(self._port.fileno(), path)

    def set_baud(self, baud: int) -> None:
        import termios

        try:
            self._port.baudrate = baud
        except (OSError, ValueError, termios.error) as error:
            raise Unplugged(f"{self._name}: {baud} baud cannot be set: {error}") from None

    def baud(self) -> int | None:
        return int(self._port.baudrate)

    def release_dtr(self) -> None:
        """Clear the line "data terminal ready", where the port has one."""
        with contextlib.suppress(OSError):
            self._port.dtr = False

    def close(self) -> None:
        self._port.close()


class TcpTransport(_FileTransport):
    """A TCP connection. Raises Unplugged where it cannot be made."""

    def __init__(self, host: str, port: int) -> None:
        name = f"{host}:{port}"
        try:
            self._socket = socket.create_connection((host, port), timeout=_CONNECT_S)
            self._socket.settimeout(None)
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        except OSError as error:
            raise Unplugged(f"{name}: cannot be reached: {error.strerror or error}") from None
        super().__init__(self._socket.fileno(), name)

    def set_baud(self, baud: int) -> None:
        return

    def baud(self) -> int | None:
        return None

    def close(self) -> None:
        self._socket.close()


def open_transport(address: str, baud: int) -> Transport:
    """A serial port by its path, or ``host:port``. Raises Unplugged."""
    tcp = tcp_address(address)
    return SerialTransport(address, baud) if tcp is None else TcpTransport(*tcp)


def tcp_address(address: str) -> tuple[str, int] | None:
    """Host and port of ``host:port``; None for the path of a device. Raises MfslamError for a port that is none."""
    host, colon, port = address.rpartition(":")
    if not colon or "/" in address or Path(address).exists():
        return None
    if not port.isdigit() or not 0 < int(port) < 65536:
        raise MfslamError(f"{address}: expected a device such as /dev/ttyACM0, or host:port")
    return host.strip("[]"), int(port)


def _reason(error: BaseException) -> str:
    """pyserial wraps the system's error into its own, twice."""
    code = getattr(error, "errno", None)
    if not isinstance(code, int):
        return str(error)
    hints = {
        errno.EACCES: " (your user must be in the port's group, often dialout)",
        errno.EAGAIN: " (another program has it open)",
    }
    return os.strerror(code).lower() + hints.get(code, "")
