"""A simulated device on a line whose time passes only while someone reads: tests of protocols need no waiting."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from itertools import islice

import numpy as np

from drivers.simulator.devices.stage import URG_MODELS, UrgModel
from drivers.simulator.devices.wire import Wire
from drivers.transport import Unplugged
from mfslam.types import IntArray, Message

STEP_S = 1e-3


class Room:
    """A scene whose ranges are known: they tell step and turn."""

    def __init__(self, model: str = "urg-04lx", motor_error: float = 0.0) -> None:
        self.urg: UrgModel = URG_MODELS[model]
        self.period_s = self.urg.period_s * (1.0 + motor_error)

    def values(self, step_0_s: float) -> IntArray:
        steps = np.arange(self.urg.first_step, self.urg.last_step + 1)
        turn = round(step_0_s / self.period_s)
        return np.asarray(100 + (steps + 7 * turn) % 3000, dtype=np.int64)


class VirtualLine:
    """A Transport. ``now_s`` is the host's clock and the device's true time."""

    def __init__(self, wire: Wire, baud: int | None = None, now_s: float = 100.0) -> None:
        self.wire, self._baud, self.time_s = wire, baud, now_s
        self.closed = True

    def open(self, address: str, baud: int) -> VirtualLine:
        if self.time_s < self.wire.unplugged_until_s:
            raise Unplugged(f"{address}: cannot be opened: no such file or directory")
        self._baud = None if self._baud is None else baud
        self.closed = False
        return self

    def pause(self, seconds: float) -> None:
        heard = len(self.wire.carried)
        for _ in range(round(seconds / STEP_S)):  # nobody listens
            self.time_s += STEP_S
            self.wire.to_host(self.time_s, self._baud)
        for block in self.wire.carried[heard:]:
            block.intact = False

    def read(self, timeout_s: float) -> bytes:
        for _ in range(max(1, math.ceil(timeout_s / STEP_S))):
            self.time_s += STEP_S
            chunk = self.wire.to_host(self.time_s, self._baud)
            if self.time_s < self.wire.unplugged_until_s:
                raise Unplugged("line: input/output error")
            if chunk:
                return chunk
        return b""

    def write(self, data: bytes) -> None:
        self.wire.to_device(data, self.time_s, self._baud)

    def set_baud(self, baud: int) -> None:
        self._baud = baud

    def baud(self) -> int | None:
        return self._baud

    def now_s(self) -> float:
        return self.time_s

    def close(self) -> None:
        self.closed = True


def until(line: VirtualLine, end_s: float) -> Callable[[], bool]:
    return lambda: line.time_s >= end_s


def first(items: Iterator[Message], count: int) -> list[Message]:
    return list(islice(items, count))
