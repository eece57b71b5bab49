"""Requests to the sensor, as bytes."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal

BIT_RATES = (19200, 38400, 57600, 115200, 250000, 500000, 750000)

UPGRADE, VERSION, PARAMETERS, STATE = b"SCIP2.0\n", b"VV\n", b"PP\n", b"II\n"
LASER_ON, QUIT, RESET = b"BM\n", b"QT\n", b"RS\n"
ADJUST_ON, ADJUST_OFF = b"TM0\n", b"TM2\n"
_MEASURE = re.compile(rb"[MG]([DS])(\d{4})(\d{4})(\d\d)(?:\d{3})?(?:;.*)?$")


def adjust_time(string: str = "") -> bytes:
    """Ask for the timer; ``string`` (at most 16 letters) is echoed and makes request and reply longer."""
    return f"TM1;{string}\n".encode() if string else b"TM1\n"


def bit_rate(baud: int) -> bytes:
    return f"SS{baud:06d}\n".encode()


@dataclass(frozen=True)
class Window:
    """Which steps are asked for. ``cluster``: so many neighbours are merged to their minimum. ``skip``: scans
    left out between two. ``short``: two characters per value (4095 mm at most) instead of three."""

    first_step: int
    last_step: int
    cluster: int = 1
    skip: int = 0
    short: bool = False

    @staticmethod
    def told(echo: bytes) -> Window | None:
        """The steps that the echo of a request for scans tells; None where it tells none."""
        match = _MEASURE.match(echo)
        if match is None:
            return None
        first, last, cluster = map(int, match.groups()[1:])
        return Window(first, last, max(1, cluster), short=match[1] == b"S") if first < last else None

    @property
    def width(self) -> int:
        return 2 if self.short else 3

    @property
    def count(self) -> int:
        """Values of a scan."""
        return -(-(self.last_step - self.first_step + 1) // max(1, self.cluster))

    @property
    def reply_bytes(self) -> int:
        """Bytes on the line for one streamed scan."""
        chars = self.count * self.width
        return 16 + 4 + 6 + chars + 2 * -(-chars // 64) + 1

    def _letters(self) -> Literal["D", "S"]:
        return "S" if self.short else "D"

    def stream(self, scans: int = 0) -> bytes:
        """MD or MS; ``scans`` 0: until QT."""
        steps = f"{self.first_step:04d}{self.last_step:04d}{self.cluster:02d}"
        return f"M{self._letters()}{steps}{self.skip:d}{scans:02d}\n".encode()

    def latest(self) -> bytes:
        """GD or GS: the latest scan, once; the laser must be on."""
        return f"G{self._letters()}{self.first_step:04d}{self.last_step:04d}{self.cluster:02d}\n".encode()
