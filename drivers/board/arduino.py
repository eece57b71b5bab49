"""The firmware of ros_arduino_bridge: ``e`` and a carriage return is answered with ``left right``.

It has neither clock nor checksum: a reading is stamped when its request had arrived, and one that no wheel
can have reached since the last is left out.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator

from drivers.board.protocol import LineSplitter
from drivers.clock_sync import Unwrapped
from drivers.live_sensor import LOOK_UP_S, LiveSensor, NoAnswer, Stopped
from drivers.transport import Transport
from mfslam.config import Config
from mfslam.types import Message, WheelTicks

REQUEST = b"e\r"
_REPLY = re.compile(rb"(-?\d{1,10}) (-?\d{1,10})")
ANSWER_S, BOOT_S = 0.2, 4.0  # opening its port starts an Arduino anew
DOUBTED = 3  # readings in a row that are left out as impossible; then the counters were set anew


class ArduinoBoard(LiveSensor):
    """WheelTicks, ``board.rate_hz`` times a second."""

    def __init__(self, address: str, config: Config, **line: object) -> None:
        super().__init__(f"arduino:{address}", address, config.board.baud or 57600, **line)  # type: ignore[arg-type]
        self._gap_s = 1.0 / config.board.rate_hz
        self._swap = config.wheels.swap_sides
        radius_m = min(config.wheels.radius_left_m, config.wheels.radius_right_m)
        turns_per_s = config.odometry.max_speed_m_s / (2.0 * math.pi * radius_m)
        self._most_ticks_per_s = turns_per_s * config.wheels.ticks_per_turn

    def _talk(self, line: Transport, stopped: Callable[[], bool]) -> Iterator[Message]:
        splitter = LineSplitter(self.health.errors)
        counters = (Unwrapped(32), Unwrapped(32))
        last: tuple[float, int, int] | None = None
        doubted = 0
        heard_s = line.now_s()
        while True:
            sent_s = line.now_s()
            counts, received_s = self._ask(line, splitter, stopped)
            if counts is None:
                if line.now_s() - heard_s > BOOT_S:
                    raise NoAnswer("no encoder counts come back (firmware of ros_arduino_bridge?)")
                continue
            heard_s = received_s
            left, right = (unwrapped(count) for unwrapped, count in zip(counters, counts, strict=True))
            if last is not None and doubted < DOUBTED and self._impossible(last, sent_s, left, right):
                self.health.errors["impossible-count"] += 1
                doubted += 1
                counters = (Unwrapped(32), Unwrapped(32))
                counters[0](last[1]), counters[1](last[2])
                continue
            last, doubted = (sent_s, left, right), 0
            yield self._message(line, sent_s, received_s, counts, left, right)
            self._wait(line, splitter, sent_s + self._gap_s)

    def _message(
        self,
        line: Transport,
        sent_s: float,
        received_s: float,
        counts: tuple[int, int],
        left: int,
        right: int,
    ) -> WheelTicks:
        byte_s = 10.0 / self.baud if line.baud() is not None else 0.0
        reply_s = byte_s * (len(f"{counts[0]} {counts[1]}") + 2)
        read_s = 0.5 * (
            sent_s + byte_s * len(REQUEST) + max(received_s - reply_s, sent_s + byte_s * len(REQUEST))
        )
        stamp_ns = self.clock.stamp_ns(read_s)
        self.health.saw(stamp_ns, received_s - read_s)
        return WheelTicks(stamp_ns, right, left) if self._swap else WheelTicks(stamp_ns, left, right)

    def _impossible(self, last: tuple[float, int, int], now_s: float, left: int, right: int) -> bool:
        most = self._most_ticks_per_s * (now_s - last[0] + self._gap_s) + 2.0
        return max(abs(left - last[1]), abs(right - last[2])) > most

    def _ask(
        self, line: Transport, splitter: LineSplitter, stopped: Callable[[], bool]
    ) -> tuple[tuple[int, int] | None, float]:
        if stopped():
            raise Stopped
        line.write(REQUEST)
        until_s = line.now_s() + ANSWER_S
        while (left_s := until_s - line.now_s()) > 0.0:
            for text in splitter.feed(line.read(left_s)):
                match = _REPLY.fullmatch(text.strip())
                if match is not None:
                    return (int(match[1]), int(match[2])), line.now_s()
                self.health.errors["garbage"] += 1
        self.health.errors["no-reply"] += 1
        return None, line.now_s()

    def _wait(self, line: Transport, splitter: LineSplitter, until_s: float) -> None:
        """Until the next reading is due; what comes unasked belongs to no request."""
        while (left_s := until_s - line.now_s()) > 0.0:
            self.health.errors["garbage"] += sum(1 for _ in splitter.feed(line.read(min(left_s, LOOK_UP_S))))
