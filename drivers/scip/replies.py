"""Bytes into replies, and replies into what they say. No I/O.

A reply is an echo of the request, a status with its sum, lines with their sums, and an empty line. Bytes get
lost and bent on the way: whatever is whole is found again, whatever is not is counted and left out.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field

from drivers.scip import codec
from drivers.scip.requests import Window
from drivers.scip.status import OK, STREAMED
from mfslam.types import IntArray

_ECHO = re.compile(
    rb"(?:M[DS]\d{13}|G[DS]\d{10}|VV|PP|II|BM|QT|RS|RT|RB|TM[012]|SS\d{6}|CR\d\d|HS\d|SCIP2\.0)(?:;.{0,16})?$"
)  # to the end of its line: before it may be garbage
_STREAM_ECHO = re.compile(rb"M[DS]\d{13}(?:;.{0,16})?$")
_NUMBER = re.compile(r"(\d+)(?:$|[\s(\[])")  # a remark may follow; the sum misses a digit's two high bits
_LONGEST_LINE = 400  # an info line is much shorter; more without a line feed is garbage


@dataclass(frozen=True)
class Reply:
    """One reply. ``command``: its two letters, "" where the echo is damaged. ``lines``: sums still on them.

    ``received_s``: host clock when its last byte was read.
    """

    echo: bytes
    command: str
    status: str
    lines: tuple[bytes, ...]
    received_s: float
    bytes_long: int


@dataclass
class ReplyParser:
    """Feeds on bytes in any pieces, gives whole replies.

    ``faults`` counts: "checksum" (a status whose sum is wrong), "cut" (a reply without status), "garbage"
    (bytes that belong to no reply).
    """

    faults: Counter[str] = field(default_factory=Counter)
    _rest: bytes = b""
    _lines: list[bytes] = field(default_factory=list)

    def feed(self, chunk: bytes, received_s: float) -> Iterator[Reply]:
        """Replies that ``chunk`` completes."""
        *lines, self._rest = (self._rest + chunk).split(b"\n")
        if len(self._rest) > _LONGEST_LINE:
            self.faults["garbage"] += 1
            self._rest, self._lines = b"", []
        for line in lines:
            line = line.rstrip(b"\r")
            begins = bool(self._lines) and _STREAM_ECHO.search(line) is not None
            if begins or not line:  # an empty line ends a reply; where it was lost, the next echo does
                yield from self._close(received_s)
            if line:
                self._lines.append(line)

    def clear(self) -> None:
        """Forget what has come in part: the line was opened anew."""
        self._rest, self._lines = b"", []

    def _close(self, received_s: float) -> Iterator[Reply]:
        lines, self._lines = self._lines, []
        if not lines:
            return
        start = next((k for k, line in enumerate(lines) if _ECHO.fullmatch(line)), 0)
        if start + 1 >= len(lines):
            self.faults["cut"] += 1
            return
        if start:
            self.faults["garbage"] += 1
        echo, status_line = lines[start], lines[start + 1]
        match = _STREAM_ECHO.search(echo) or _ECHO.search(echo)
        status = codec.without_sum(status_line) if len(status_line) == 3 else None
        if status is None and match is not None and match.group() == b"SCIP2.0" and status_line == b"0":
            status = b"00"  # SCIP 1.1 has neither sums nor two digits
        if status is None:
            self.faults["checksum"] += 1
            return
        command = match.group()[:2].decode() if match else ""
        yield Reply(
            match.group() if match else echo,
            command,
            status.decode("ascii", "replace"),
            tuple(lines[start + 2 :]),
            received_s,
            sum(len(line) + 1 for line in lines[start:]) + 1,
        )


class DamagedReply(ValueError):
    """A reply whose sums or length are wrong; ``fault`` is "checksum" or "cut"."""

    def __init__(self, fault: str) -> None:
        super().__init__(fault)
        self.fault = fault


@dataclass(frozen=True, eq=False)
class RawScan:
    """A scan as the sensor tells it. ``timestamp_ms``: 24-bit timer at step 0. ``values`` (N,) of the steps in
    ``window``: mm, or a code below DMIN."""

    timestamp_ms: int
    values: IntArray
    window: Window
    received_s: float
    bytes_long: int


def scan_of(reply: Reply, asked: Window) -> RawScan:
    """The scan of an MD, MS, GD or GS reply, of the window that its echo tells. Raises DamagedReply.

    The echo has no sum: a scan whose own sums are right counts although its echo is damaged, as one of the
    window ``asked`` for.
    """
    payload = _payload(reply)
    for window in (Window.told(reply.echo), asked):
        if window is not None and len(payload) == 4 + window.count * window.width:
            timestamp, values = codec.decode(payload[:4], 4), codec.decode(payload[4:], window.width)
            return RawScan(int(timestamp[0]), values, window, reply.received_s, reply.bytes_long)
    raise DamagedReply("cut")


def _payload(reply: Reply) -> bytes:
    parts = []
    for line in reply.lines:
        text = codec.without_sum(line)
        if text is None or not codec.is_data(text):
            raise DamagedReply("checksum")
        parts.append(text)
    if not parts or len(parts[0]) != 4 or any(len(part) != codec.LINE_CHARS for part in parts[1:-1]):
        raise DamagedReply("cut")  # lines that two bent sums have let through
    return b"".join(parts)


def is_scan(reply: Reply) -> bool:
    """A scan of a running MD or MS, or one of GD or GS; also one whose echo is damaged."""
    if reply.status == STREAMED:
        return reply.command in ("MD", "MS", "")
    asked = reply.status == OK and reply.command in ("GD", "GS", "")
    return asked and len(reply.lines) > 1 and len(reply.lines[0]) == 5  # a timestamp with its sum


def timer_of(reply: Reply) -> int:
    """Milliseconds (24 bits) of a TM1 reply. Raises DamagedReply."""
    payload = codec.without_sum(reply.lines[0]) if len(reply.lines) == 1 else None
    if payload is None or len(payload) != 4 or not codec.is_data(payload):
        raise DamagedReply("checksum")
    return int(codec.decode(payload, 4)[0])


def info_of(reply: Reply) -> tuple[dict[str, str], int]:
    """Keys and values of a VV, PP or II reply, and how many lines have a wrong sum (kept all the same)."""
    out: dict[str, str] = {}
    wrong = 0
    for line in reply.lines:
        text, right = codec.without_info_sum(line)
        wrong += not right
        key, colon, value = text.decode("ascii", "replace").partition(":")
        if colon:
            out[key.strip()] = value.strip()
    return out, wrong


@dataclass(frozen=True)
class Parameters:
    """The sensor's geometry as PP tells it: ranges in mm, steps of ``steps_per_turn``, motor in rpm."""

    model: str
    min_mm: int
    max_mm: int
    steps_per_turn: int
    first_step: int
    last_step: int
    front_step: int
    rpm: int


def parameters_of(info: dict[str, str]) -> Parameters:
    """Raises ValueError, with the key, for what is missing or cannot be."""
    numbers = {}
    for key in ("DMIN", "DMAX", "ARES", "AMIN", "AMAX", "AFRT", "SCAN"):
        digits = _NUMBER.match(info.get(key, ""))
        if digits is None:
            raise ValueError(f"{key} is {info.get(key)!r}")
        numbers[key] = int(digits[1])
    found = Parameters(info.get("MODL", "unknown"), *numbers.values())
    if not (found.first_step < found.last_step and 0 < found.steps_per_turn <= 100_000 and found.rpm > 0):
        raise ValueError("steps or motor speed cannot be")
    return found
