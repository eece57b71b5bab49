"""The line protocol of an encoder board (docs/sensors.md): text, one reading a line, CRC-16. No I/O.

``$W,time_us,left,right,gyro_urad_s,heading_cdeg*CRC`` is a reading, gyro and heading may be empty.
``$T,time_us*CRC`` answers the request ``?``.
"""

from __future__ import annotations

import binascii
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field

TIME_REQUEST = b"?\n"
_LINE = re.compile(
    rb"\$(?:W,(\d{1,10}),(-?\d{1,10}),(-?\d{1,10}),(-?\d{1,9})?,(-?\d{1,6})?|T,(\d{1,10}))\*([0-9A-F]{4})"
)
_LONGEST = 128


@dataclass(frozen=True)
class Reading:
    """``time_us``: 32-bit clock of the board. ``left``, ``right``: 32-bit counters, forward positive. A board
    without gyro or compass leaves them None; the heading is anticlockwise from any fixed direction."""

    time_us: int
    left: int
    right: int
    gyro_urad_s: int | None = None
    heading_cdeg: int | None = None


@dataclass(frozen=True)
class TimeTold:
    """The board's clock when a request for it had come."""

    time_us: int


def crc16(text: bytes) -> int:
    """CRC-16/XMODEM: polynomial 0x1021, start 0 (``_crc_xmodem_update`` of avr-libc)."""
    return binascii.crc_hqx(text, 0)


def framed(text: str) -> bytes:
    """``$text*CRC`` and a line feed; the CRC is of the text."""
    return f"${text}*{crc16(text.encode()):04X}\n".encode()


def reading_line(reading: Reading) -> bytes:
    gyro = "" if reading.gyro_urad_s is None else reading.gyro_urad_s
    heading = "" if reading.heading_cdeg is None else reading.heading_cdeg
    return framed(f"W,{reading.time_us},{reading.left},{reading.right},{gyro},{heading}")


def time_line(time_us: int) -> bytes:
    return framed(f"T,{time_us}")


def parse_line(line: bytes) -> Reading | TimeTold | None:
    """What a whole line says; None where it is damaged."""
    match = _LINE.fullmatch(line)
    if match is None or crc16(line[1:-5]) != int(match[7], 16):
        return None
    if match[6] is not None:
        return TimeTold(int(match[6]))
    gyro, heading = (None if text is None else int(text) for text in match.group(4, 5))
    return Reading(int(match[1]), int(match[2]), int(match[3]), gyro, heading)


@dataclass
class LineSplitter:
    """Bytes in any pieces into lines. ``faults`` counts "garbage" (a line that never ends)."""

    faults: Counter[str] = field(default_factory=Counter)
    _rest: bytes = b""

    def feed(self, chunk: bytes) -> Iterator[bytes]:
        """Whole lines without their ends; empty ones are left out."""
        *lines, self._rest = (self._rest + chunk).replace(b"\r", b"\n").split(b"\n")
        if len(self._rest) > _LONGEST:
            self.faults["garbage"] += 1
            self._rest = b""
        yield from (line for line in lines if line)
