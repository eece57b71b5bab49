"""A simulated RPLIDAR: what it is, its health, its motor, standard scans. No I/O: bytes in, blocks out."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass, field
from typing import Protocol

from drivers.rplidar import protocol
from drivers.simulator.devices.wire import Block, LineFault
from mfslam.types import IntArray

BOOT_S = 1.0
_SERIES = {"a1": 0x18, "a2": 0x2C, "a3": 0x31, "c1": 0x41, "s1": 0x61, "s2": 0x71, "s3": 0x81}
_BANNER = b"RP LIDAR System.\r\nFirmware Ver 1.32, HW Ver 6\r\n"


class TurningScene(Protocol):
    """Where ranges come from."""

    @property
    def period_s(self) -> float: ...

    def values(self, step_0_s: float) -> IntArray:
        """(N,) mm, 0 for nothing, of a turn that begins then; each beam at its own instant."""
        ...


@dataclass
class SimulatedRplidar:
    """``model``: "a1" to "s3". ``health``: 0 good, 2 stopped to protect itself; RESET mends it ``mends`` times. Where
    ``adapter`` is true, a board drives the motor of an A2 or A3 by PWM."""

    scene: TurningScene
    model: str = "a2"
    baud: int = 115200
    start_s: float = 0.0
    health: int = 0
    mends: bool = True
    adapter: bool = True
    scanning: bool = False
    turning: bool = True
    _out: list[Block] = field(default_factory=list)
    _request: bytes = b""
    _next: int | None = None  # point to be told, of all since the start; None when a scan begins
    _turn: int = -1
    _values: IntArray | None = None
    _silent_until_s: float = -math.inf

    def __post_init__(self) -> None:
        series = _SERIES[self.model] >> 4
        self.turning = not (series >= 4 or (series >= 2 and self.adapter))  # else whoever asks starts it

    def receive(self, data: bytes, now_s: float) -> None:
        self._request += data
        while (at := self._request.find(b"\xa5")) >= 0 and len(self._request) - at >= 2:
            command, text = self._request[at + 1], self._request[at:]
            has_payload = command & 0x80 != 0
            whole = 2 if not has_payload else 4 + text[2] if len(text) > 2 else 1 << 30
            if len(text) < whole:
                return
            self._request = text[whole:]
            payload = text[3 : whole - 1]
            if text[:whole] == protocol.request(command, payload) and now_s >= self._silent_until_s:
                self._obey(command, payload, now_s)

    def speak(self, now_s: float, busy: bool) -> list[Block]:
        if now_s >= self._silent_until_s:
            self._measure(now_s)
        out, self._out = self._out, []
        return out

    def obey(self, fault: LineFault, now_s: float) -> None:
        if fault.kind == "status":
            self.health, self.scanning = int(fault.value), False
        elif fault.kind == "laser-off":
            self.turning = False

    def power_cycle(self, now_s: float) -> None:
        self._boot(now_s)
        self.__post_init__()

    def _boot(self, now_s: float) -> None:
        self.scanning, self._silent_until_s, self._request = False, now_s + BOOT_S, b""

    def _obey(self, command: int, payload: bytes, now_s: float) -> None:
        series = _SERIES[self.model] >> 4
        if command == protocol.STOP:
            self.scanning = False
        elif command == protocol.RESET:
            self._boot(now_s)
            self._out.append(Block(_BANNER))
            self.health = 0 if self.mends else self.health
        elif command == protocol.INFO:
            self._answer(
                protocol.INFO_ANSWER, struct.pack("<4B", _SERIES[self.model], 32, 1, 6) + bytes(range(16))
            )
        elif command == protocol.HEALTH:
            self._answer(protocol.HEALTH_ANSWER, struct.pack("<BH", self.health, 7 * (self.health > 0)))
        elif command == protocol.ADAPTER_FLAGS and series < 4:
            self._answer(protocol.ADAPTER_ANSWER, struct.pack("<I", self.adapter))
        elif command == (protocol.MOTOR_RPM if series >= 4 else protocol.MOTOR_PWM):
            self.turning = struct.unpack("<H", payload)[0] > 0
        elif command == protocol.SCAN and self.health != 2:
            self._out.append(Block(protocol.descriptor(protocol.SCAN_ANSWER, many=True)))
            self.scanning, self._next, self._turn = True, None, -1

    def _answer(self, kind: int, payload: bytes) -> None:
        self._out.append(Block(protocol.descriptor(kind) + payload))

    def _measure(self, now_s: float) -> None:
        """Points whose instant has come; a motor that stands still tells the same bearing again and again."""
        if not self.scanning:
            return
        if self._values is None:
            self._values = self.scene.values(0.0)
        count = len(self._values)
        step_s = self.scene.period_s / count
        due = math.floor((now_s - self.start_s) / step_s)
        if self._next is None:
            self._next = due
        told = []
        while self._next < due:
            turn, k = divmod(self._next, count)
            if turn != self._turn:
                self._turn, self._values = turn, self.scene.values(turn * self.scene.period_s)
            k = k if self.turning else 0
            told.append(protocol.point(k * 360.0 / count, float(self._values[k]), begins=k == 0))
            self._next += 1
        if told:
            begun_s = self.start_s + self._turn * self.scene.period_s
            record = {"turn_s": begun_s, "values": self._values.tolist()}
            self._out.append(Block(b"".join(told), record))
