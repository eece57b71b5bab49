"""The cable between a device and the host: it takes its time, and bends what goes over it. No I/O."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Annotated, Literal, Protocol

import numpy as np
from pydantic import ConfigDict, Field, with_config

BITS_PER_BYTE = 10.0  # 8N1


@dataclass(eq=False)
class Block:
    """Bytes that a device sends together. ``record``: what a test wants to know of it, None for nothing."""

    data: bytes
    record: dict[str, object] | None = None
    intact: bool = True


class Device(Protocol):
    """What is at the other end: requests in, replies out, all at instants (s) of one clock."""

    @property
    def baud(self) -> int:
        """Bit rate that it speaks now."""
        ...

    def receive(self, data: bytes, now_s: float) -> None: ...

    def speak(self, now_s: float, busy: bool) -> list[Block]:
        """What it begins to send by ``now_s``. ``busy``: earlier blocks are still on their way."""
        ...

    def obey(self, fault: LineFault, now_s: float) -> None:
        """A fault of the device itself."""
        ...

    def power_cycle(self, now_s: float) -> None: ...


FaultKind = Literal["garbage", "lost", "unplug", "power", "stall", "status", "laser-off"]


@with_config(ConfigDict(allow_inf_nan=False))
@dataclass(frozen=True)
class LineFault:
    """Something that happens once. ``value``: bytes of garbage or lost bytes; seconds of an unplug, a power
    cut or a stall; the code of a status; nothing for laser-off."""

    at_s: float
    kind: FaultKind
    value: float = 0.0


@with_config(ConfigDict(allow_inf_nan=False))
@dataclass(frozen=True)
class LineFaults:
    """What goes wrong between sensor and host. Times in s from the start."""

    bit_flips: Annotated[float, Field(ge=0, lt=1, description="Share of bits that flip.")] = 0.0
    once: tuple[LineFault, ...] = ()


@dataclass
class Wire:
    """Carries blocks at the device's bit rate. ``carried``: blocks with a record, once they are through."""

    device: Device
    faults: LineFaults = field(default_factory=LineFaults)
    seed: int = 0
    paced: bool = True  # False: as over USB or TCP
    carried: list[Block] = field(default_factory=list)
    start_s: float | None = None

    def __post_init__(self) -> None:
        self._rng = np.random.default_rng(self.seed)
        self._blocks: deque[Block] = deque()
        self._at = 0  # bytes of the first block that are through
        self._credit_s = 0.0  # time that is not used up by bytes yet
        self._last_s: float | None = None
        self._todo = sorted(self.faults.once, key=lambda fault: fault.at_s)
        self._to_lose = 0
        self._stalled_until_s = -1.0
        self.unplugged_until_s = -1.0

    def to_device(self, data: bytes, now_s: float, host_baud: int | None = None) -> None:
        """Bytes from the host; at another bit rate than the device's they are noise."""
        self._start(now_s)
        if self._deaf(host_baud):
            data = self._noise(len(data))
        self.device.receive(self._bent(data), now_s)

    def to_host(self, now_s: float, host_baud: int | None = None) -> bytes:
        """What has come through by ``now_s``."""
        self._start(now_s)
        assert self.start_s is not None
        since_s = now_s - (now_s if self._last_s is None else self._last_s)
        self._last_s = now_s
        while self._todo and self._todo[0].at_s <= now_s - self.start_s:
            self._begin(self._todo.pop(0), now_s)
        if now_s < self._stalled_until_s:
            return b""
        for block in self.device.speak(now_s, bool(self._blocks)):
            self._send(block)
        if self._to_lose and self._blocks:  # where nothing is under way it hits what comes next
            self._lose()
        if now_s < self.unplugged_until_s:
            self._drop()
            return b""
        self._credit_s = self._credit_s + since_s if self._blocks else 0.0
        most = int(self._credit_s * self.device.baud / BITS_PER_BYTE) if self.paced else 1 << 30
        out = self._take(most)
        self._credit_s -= len(out) * BITS_PER_BYTE / self.device.baud
        return self._noise(len(out)) if self._deaf(host_baud) else out

    def _start(self, now_s: float) -> None:
        """What was said before anyone listened is lost."""
        if self.start_s is None:
            self.start_s = now_s
            self.device.speak(now_s, False)

    def _take(self, most: int) -> bytes:
        out = bytearray()
        while self._blocks and most > 0:
            block = self._blocks[0]
            piece = block.data[self._at : self._at + most]
            out += piece
            most -= len(piece)
            self._at += len(piece)
            if self._at == len(block.data):
                self._finish(self._blocks.popleft())
        return bytes(out)

    def _send(self, block: Block) -> None:
        bent = self._bent(block.data)
        if bent != block.data:
            block.intact, block.data = False, bent
        self._blocks.append(block)

    def _finish(self, block: Block) -> None:
        self._at = 0
        if block.record is not None:
            self.carried.append(block)

    def _drop(self) -> None:
        for block in self._blocks:
            block.intact = False
            self._finish(block)
        self._blocks.clear()

    def _begin(self, fault: LineFault, now_s: float) -> None:
        if fault.kind == "garbage":
            self._blocks.append(Block(self._noise(int(fault.value))))
        elif fault.kind == "lost":
            self._to_lose = int(fault.value)
        elif fault.kind == "stall":
            self._stalled_until_s = now_s + fault.value
        elif fault.kind in ("unplug", "power"):
            self._drop()
            self.unplugged_until_s = now_s + fault.value
            if fault.kind == "power":
                self.device.power_cycle(now_s + fault.value)
        else:
            self.device.obey(fault, now_s)

    def _lose(self) -> None:
        """Bytes that are on their way vanish: half lines."""
        count, self._to_lose = self._to_lose, 0
        block = self._blocks[0]
        block.intact = False
        block.data = block.data[: self._at] + block.data[self._at + count :]
        if self._at >= len(block.data):
            self._finish(self._blocks.popleft())

    def _bent(self, data: bytes) -> bytes:
        if not self.faults.bit_flips or not data:
            return data
        flips = self._rng.random(8 * len(data)) < self.faults.bit_flips
        return (np.frombuffer(data, np.uint8) ^ np.packbits(flips)).tobytes() if flips.any() else data

    def _noise(self, count: int) -> bytes:
        return self._rng.integers(0, 256, count, dtype=np.uint8).tobytes()

    def _deaf(self, host_baud: int | None) -> bool:
        return host_baud is not None and self.paced and host_baud != self.device.baud
