"""A simulated Hokuyo: SCIP 1.1 after power on where wanted, SCIP 2.0 in full. No I/O: bytes in, blocks out."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from drivers.scip import codec, requests
from drivers.scip.requests import Window
from drivers.simulator.devices.stage import UrgModel
from drivers.simulator.devices.wire import Block, LineFault
from mfslam.types import IntArray

TIMER_MASK = (1 << 24) - 1
_MEASURE = re.compile(rb"([MG])([DS])(\d{4})(\d{4})(\d\d)(?:(\d)(\d\d))?$")
_LONGEST_REQUEST = 64


class Scene(Protocol):
    """Where ranges come from."""

    urg: UrgModel

    @property
    def period_s(self) -> float: ...

    def values(self, step_0_s: float) -> IntArray: ...


@dataclass
class SimulatedUrg:
    """``scene`` is sensed from the instant ``start_s`` on; ``timer_ms`` is what the timer shows then, ``drift``
    what it gains, s per s. ``scip1``: it wakes up in SCIP 1.1."""

    scene: Scene
    baud: int = 19200
    scip1: bool = False
    timer_ms: float = 0.0
    drift: float = 0.0
    start_s: float = 0.0
    laser_on: bool = False
    _out: list[Block] = field(default_factory=list)
    _request: bytes = b""
    _window: Window | None = None
    _echo: bytes = b""
    _left: int = 0  # scans to send; -1: until QT
    _adjusting: bool = False
    _next_turn: int = 0
    _silent_until_s: float = -1.0
    _next_baud: int | None = None

    def __post_init__(self) -> None:
        self._power_on_baud, self._wakes_in_scip1 = self.baud, self.scip1

    # --- what the wire asks for -----------------------------------------------------------------------

    def receive(self, data: bytes, now_s: float) -> None:
        for byte in data:
            if byte not in b"\r\n":
                self._request = (self._request + bytes([byte]))[-_LONGEST_REQUEST:]
            elif self._request:
                request, self._request = self._request, b""
                self._answer(request, now_s)

    def speak(self, now_s: float, busy: bool) -> list[Block]:
        self._measure(now_s, busy)
        out, self._out = self._out, []
        if self._next_baud is not None and not out and not busy:
            self.baud, self._next_baud = self._next_baud, None
        return out

    def obey(self, fault: LineFault, now_s: float) -> None:
        if fault.kind == "laser-off":
            self._stop()
            self.laser_on = False
        elif fault.kind == "status" and self._window is not None:
            self._reply(self._echo, f"{int(fault.value):02d}")
            if fault.value >= 50 and fault.value != 98:
                self._stop()
            else:  # it verifies for a second, then goes on
                self._silent_until_s = now_s + 1.0

    def power_cycle(self, now_s: float) -> None:
        self._stop()
        self.laser_on, self._adjusting = False, False
        self.baud, self.scip1 = self._power_on_baud, self._wakes_in_scip1
        self.timer_ms = -(now_s - self.start_s) * 1e3 * (1.0 + self.drift)  # zero at now_s

    # --- requests -------------------------------------------------------------------------------------

    def _answer(self, request: bytes, now_s: float) -> None:
        command = request.split(b";")[0]
        if self.scip1:
            if command == b"SCIP2.0":
                self.scip1 = False
                self._out.append(Block(request + b"\n0\n\n"))
            return
        handlers: dict[bytes, Callable[[bytes, bytes, float], None]] = {
            b"VV": self._version, b"PP": self._parameters, b"II": self._state, b"BM": self._laser,
            b"QT": self._quit, b"RS": self._reset, b"TM": self._adjust, b"SS": self._bit_rate,
            b"MD": self._measuring, b"MS": self._measuring, b"GD": self._measuring, b"GS": self._measuring,
        }  # fmt: skip
        handler = handlers.get(command[:2])
        if handler is None:
            self._reply(request, "0E")
        else:
            handler(request, command, now_s)

    def _reply(self, echo: bytes, status: str, lines: tuple[bytes, ...] = ()) -> None:
        whole = [echo, codec.with_sum(status.encode()), *lines]
        self._out.append(Block(b"\n".join(whole) + b"\n\n"))

    def _info(self, echo: bytes, **told: object) -> None:
        texts = [f"{key}:{value}".encode() for key, value in told.items()]
        self._reply(echo, "00", tuple(t + b";" + bytes([codec.check_sum(t)]) for t in texts))

    def _version(self, request: bytes, command: bytes, now_s: float) -> None:
        product = f"SOKUIKI Sensor {self.scene.urg.name.split('(')[0]}"
        self._info(
            request, VEND="mfslam simulator", PROD=product, FIRM="3.3.00", PROT="SCIP 2.0", SERI="H0000000"
        )

    def _parameters(self, request: bytes, command: bytes, now_s: float) -> None:
        urg = self.scene.urg
        self._info(
            request, MODL=urg.name, DMIN=urg.min_mm, DMAX=urg.max_mm, ARES=urg.steps_per_turn, AMIN=urg.first_step,
            AMAX=urg.last_step, AFRT=urg.front_step, SCAN=urg.rpm,
        )  # fmt: skip

    def _state(self, request: bytes, command: bytes, now_s: float) -> None:
        self._info(
            request, MODL=self.scene.urg.name, LASR="ON" if self.laser_on else "OFF", SCSP=f"{self.scene.urg.rpm}[rpm]",
            SBPS=f"{self.baud}[bps]", TIME=f"{self._timer(now_s):06X}", STAT="Sensor works well.",
        )  # fmt: skip

    def _laser(self, request: bytes, command: bytes, now_s: float) -> None:
        self._reply(request, "02" if self.laser_on else "00")
        self.laser_on = True

    def _quit(self, request: bytes, command: bytes, now_s: float) -> None:
        self._stop()
        self.laser_on = False
        self._reply(request, "00")

    def _reset(self, request: bytes, command: bytes, now_s: float) -> None:
        self._reply(request, "00")
        self._stop()
        self.laser_on, self._adjusting = False, False
        self.timer_ms = -(now_s - self.start_s) * 1e3 * (1.0 + self.drift)

    def _adjust(self, request: bytes, command: bytes, now_s: float) -> None:
        code = command[2:]
        if code == b"1":
            if not self._adjusting:
                self._reply(request, "04")
                return
            timer = codec.encode(np.array([self._timer(now_s)]), 4)
            self._reply(request, "00", (codec.with_sum(timer),))
        elif code in (b"0", b"2"):
            on = code == b"0"
            self._reply(request, ("02" if on else "03") if self._adjusting == on else "00")
            self._adjusting = on
            self._stop()
        else:
            self._reply(request, "01")

    def _bit_rate(self, request: bytes, command: bytes, now_s: float) -> None:
        digits = command[2:]
        if not digits.isdigit():
            self._reply(request, "01")
        elif int(digits) not in requests.BIT_RATES:
            self._reply(request, "02")
        elif int(digits) == self.baud:
            self._reply(request, "03")
        else:
            self._reply(request, "00")
            self._next_baud = int(digits)

    def _measuring(self, request: bytes, command: bytes, now_s: float) -> None:
        urg, match = self.scene.urg, _MEASURE.match(command)
        if match is None or (match[1] == b"M") != (match[6] is not None):
            self._reply(request, "0C")
            return
        first, last, cluster = (int(match[k]) for k in (3, 4, 5))
        if first > last or last > urg.last_step:
            self._reply(request, "05" if first > last else "04")
            return
        window = Window(first, last, max(1, cluster), int(match[6] or 0), match[2] == b"S")
        if match[1] == b"G":
            self._latest(request, window, now_s)
            return
        self._reply(request, "00")
        self._window, self._echo, self._left = window, request, int(match[7]) or -1
        self.laser_on, self._adjusting = True, False
        self._next_turn = self._turn(now_s) + 1

    # --- measuring ------------------------------------------------------------------------------------

    def _stop(self) -> None:
        self._window = None

    def _timer(self, now_s: float) -> int:
        return int(self.timer_ms + (now_s - self.start_s) * 1e3 * (1.0 + self.drift)) & TIMER_MASK

    def _turn(self, now_s: float) -> int:
        return int((now_s - self.start_s) / self.scene.period_s)

    def _begun_s(self, turn: int) -> float:
        return self.start_s + turn * self.scene.period_s

    def _measure(self, now_s: float, busy: bool) -> None:
        """Scans whose last step has been sensed by now; those that would wait for the line are left out."""
        if self._window is None:
            return
        urg, window = self.scene.urg, self._window
        to_last_s = (window.last_step + 1) / urg.steps_per_turn * self.scene.period_s
        while self._window is not None and self._begun_s(self._next_turn) + to_last_s <= now_s:
            turn = self._next_turn
            self._next_turn += 1 + window.skip
            if busy or now_s < self._silent_until_s:
                continue
            if self._silent_until_s > 0.0:
                self._silent_until_s = -1.0
                self._reply(self._echo, "98")
            self._left -= self._left > 0
            echo = self._echo[:13] + f"{max(0, self._left):02d}".encode() + self._echo[15:]
            self._out.append(self._scan(echo, "99", window, turn))
            busy = True
            if self._left == 0:
                self._stop()

    def _latest(self, request: bytes, window: Window, now_s: float) -> None:
        if not self.laser_on:
            self._reply(request, "10")
            return
        to_last_s = (window.last_step + 1) / self.scene.urg.steps_per_turn * self.scene.period_s
        self._out.append(self._scan(request, "00", window, self._turn(now_s - to_last_s)))

    def _scan(self, echo: bytes, status: str, window: Window, turn: int) -> Block:
        begun_s = self._begun_s(turn)
        timer = self._timer(begun_s)
        values = self._merged(window, self.scene.values(begun_s - self.start_s))
        head = [echo, codec.with_sum(status.encode()), codec.with_sum(codec.encode(np.array([timer]), 4))]
        lines = codec.to_lines(codec.encode(values, window.width))
        record: dict[str, object] = {"timer_ms": timer, "step_0_s": begun_s, "values": values.tolist()}
        return Block(b"\n".join(head + lines) + b"\n\n", record)

    def _merged(self, window: Window, values: IntArray) -> IntArray:
        """The window's steps, the nearest of each cluster; steps that are not measured have code 19."""
        urg = self.scene.urg
        steps = np.full(urg.last_step + 1, 19, dtype=np.int64)
        steps[urg.first_step :] = values
        asked = steps[window.first_step : window.last_step + 1]
        pad = -len(asked) % window.cluster
        merged = np.pad(asked, (0, pad), mode="edge").reshape(-1, window.cluster).min(axis=1)
        return np.asarray(np.minimum(merged, 64**window.width - 1), dtype=np.int64)
