"""Simulated encoder boards: the line protocol, and the firmware of ros_arduino_bridge. No I/O."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Protocol

from drivers.board.protocol import TIME_REQUEST, Reading, reading_line, time_line
from drivers.simulator.devices.wire import Block, LineFault

BOOT_S = 1.5
_MASK = (1 << 32) - 1


class Drive(Protocol):
    """Where counts come from; times in s from the start."""

    def ticks(self, at_s: float) -> tuple[int, int]: ...

    def gyro_rad_s(self, at_s: float) -> float: ...

    def heading_rad(self, at_s: float) -> float: ...


def _signed(count: int) -> int:
    """A counter as its 32 bits have it."""
    return (count + (1 << 31) & _MASK) - (1 << 31)


@dataclass
class StreamingBoardDevice:
    """Sends readings of ticks, gyro and heading ``rate_hz`` times a second by its own clock, which shows
    ``time_us`` at ``start_s`` and gains ``drift``. ``count_from``: of both counters at the start."""

    scene: Drive
    rate_hz: float = 100.0
    baud: int = 115200
    time_us: int = 0
    drift: float = 0.0
    start_s: float = 0.0
    count_from: int = 0
    with_gyro: bool = True
    _next: int = 0
    _request: bytes = b""
    _out: list[Block] = field(default_factory=list)
    _silent_until_s: float = -math.inf

    def receive(self, data: bytes, now_s: float) -> None:
        self._request = (self._request + data)[-len(TIME_REQUEST) :]
        if self._request == TIME_REQUEST and now_s >= self._silent_until_s:
            self._out.append(Block(time_line(self._clock_us(now_s))))
            self._request = b""

    def speak(self, now_s: float, busy: bool) -> list[Block]:
        out, self._out = self._out, []
        while (at_s := self.start_s + self._next / self.rate_hz) <= now_s:
            self._next += 1
            if at_s >= self._silent_until_s:
                out.append(self._reading(at_s))
        return out

    def obey(self, fault: LineFault, now_s: float) -> None:
        return

    def power_cycle(self, now_s: float) -> None:
        """Clock and counters begin at zero; it takes a while to boot."""
        self._silent_until_s = now_s + BOOT_S
        self.time_us = -round((now_s - self.start_s) * 1e6 * (1.0 + self.drift))
        self.count_from -= self.scene.ticks(now_s - self.start_s)[0] + self.count_from

    def _clock_us(self, now_s: float) -> int:
        return self.time_us + int((now_s - self.start_s) * 1e6 * (1.0 + self.drift)) & _MASK

    def _reading(self, at_s: float) -> Block:
        since_s = at_s - self.start_s
        left, right = (_signed(count + self.count_from) for count in self.scene.ticks(since_s))
        gyro = heading = None
        if self.with_gyro:
            gyro = round(self.scene.gyro_rad_s(since_s) * 1e6)
            heading = round(math.degrees(self.scene.heading_rad(since_s)) * 100.0)
        line = reading_line(Reading(self._clock_us(at_s), left, right, gyro, heading))
        return Block(line, {"at_s": at_s, "left": left, "right": right})


@dataclass
class ArduinoDevice:
    """Answers ``e`` with its counters and anything else as ros_arduino_bridge does."""

    scene: Drive
    baud: int = 57600
    start_s: float = 0.0
    answer_s: float = 0.0005
    _request: bytes = b""
    _due: list[tuple[float, Block]] = field(default_factory=list)
    _zero: tuple[int, int] = (0, 0)
    _silent_until_s: float = -math.inf

    def receive(self, data: bytes, now_s: float) -> None:
        for byte in data:
            if byte != 13:
                self._request += bytes([byte])
                continue
            request, self._request = self._request, b""
            if now_s >= self._silent_until_s:
                self._due.append((now_s + self.answer_s, self._answer(request, now_s)))

    def speak(self, now_s: float, busy: bool) -> list[Block]:
        out = [block for due_s, block in self._due if due_s <= now_s]
        self._due = [(due_s, block) for due_s, block in self._due if due_s > now_s]
        return out

    def obey(self, fault: LineFault, now_s: float) -> None:
        return

    def power_cycle(self, now_s: float) -> None:
        self._silent_until_s = now_s + BOOT_S
        self._zero = self.scene.ticks(now_s - self.start_s)

    def _answer(self, request: bytes, now_s: float) -> Block:
        now = self.scene.ticks(now_s - self.start_s)
        if request == b"e":
            left, right = (_signed(count - zero) for count, zero in zip(now, self._zero, strict=True))
            return Block(f"{left} {right}\r\n".encode(), {"at_s": now_s, "left": left, "right": right})
        if request == b"r":
            self._zero = now
            return Block(b"OK\r\n")
        return Block(f"{self.baud}\r\n".encode() if request == b"b" else b"Invalid Command\r\n")
