"""A board that sends readings by itself, in the line protocol, by its own clock."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from drivers.board.protocol import TIME_REQUEST, LineSplitter, Reading, TimeTold, parse_line
from drivers.clock_sync import ClockSync, Unwrapped
from drivers.live_sensor import LOOK_UP_S, LiveSensor, NoAnswer, Stopped
from drivers.transport import Transport
from mfslam.config import Config
from mfslam.types import Imu, Message, WheelTicks

SILENT_S = 3.0  # many boards start anew when their port is opened, and take this long
ASK_EVERY_S, ASK_COUNT = 0.1, 20
TICK_S = 1e-6
CLOCK_S = 0.5  # readings wait so long for the board's clock to be known, then their arrival tells it


class StreamingBoard(LiveSensor):
    """WheelTicks, and Imu where the board has a gyro or compass; see docs/sensors.md."""

    def __init__(self, address: str, config: Config, **line: object) -> None:
        super().__init__(f"board:{address}", address, config.board.baud or 115200, **line)  # type: ignore[arg-type]
        self._swap = config.wheels.swap_sides

    def _talk(self, line: Transport, stopped: Callable[[], bool]) -> Iterator[Message]:
        splitter, talk = LineSplitter(self.health.errors), _Talk()
        byte_s = 10.0 / self.baud if line.baud() is not None else 0.0
        waiting: list[_Arrival] = []
        opened_s = heard_s = line.now_s()
        begun = False  # the first line is one that we came too late for
        while True:
            if stopped():
                raise Stopped
            if line.now_s() - heard_s > SILENT_S:
                raise NoAnswer(f"no reading in {SILENT_S:g} s")
            talk.ask(line)
            chunk = line.read(LOOK_UP_S if talk.asked >= ASK_COUNT else ASK_EVERY_S)
            received_s = line.now_s()
            for text in splitter.feed(chunk):
                told = parse_line(text)
                if told is None:
                    self.health.errors["checksum"] += begun
                elif isinstance(told, TimeTold):
                    talk.answered(told, received_s, byte_s * (len(text) + 1), byte_s * len(TIME_REQUEST))
                else:
                    heard_s = received_s
                    waiting.append(_Arrival(told, received_s, byte_s * (len(text) + 1)))
                begun = True
            if talk.clock_known or received_s - opened_s > CLOCK_S:
                for arrival in waiting:
                    yield from self._messages(arrival, talk)
                waiting.clear()

    def _messages(self, arrival: _Arrival, talk: _Talk) -> Iterator[Message]:
        reading, host_s = arrival.reading, talk.host_s(arrival)
        if host_s is None:
            self.health.errors["board-clock-set-anew"] += 1
            talk.start_anew()
            host_s = talk.host_s(arrival)
            assert host_s is not None
        stamp_ns = self.clock.stamp_ns(host_s)
        self.health.saw(stamp_ns, arrival.received_s - host_s)
        left, right = talk.left(reading.left), talk.right(reading.right)
        yield WheelTicks(stamp_ns, right, left) if self._swap else WheelTicks(stamp_ns, left, right)
        if reading.gyro_urad_s is not None or reading.heading_cdeg is not None:
            rate = None if reading.gyro_urad_s is None else reading.gyro_urad_s * 1e-6
            yaw = None if reading.heading_cdeg is None else math.radians(reading.heading_cdeg * 0.01)
            yield Imu(stamp_ns, rate, yaw)


@dataclass(frozen=True)
class _Arrival:
    """A reading that came; ``transfer_s``: what its bytes take on the line."""

    reading: Reading
    received_s: float
    transfer_s: float


class _Talk:
    """The board's clock and counters since the line was opened."""

    def __init__(self) -> None:
        self.asked = 0
        self._sent_s: float | None = None
        self._ask_at_s = 0.0
        self.start_anew()

    def start_anew(self) -> None:
        self.left, self.right = Unwrapped(32), Unwrapped(32)
        self._time, self._clock = Unwrapped(32), ClockSync(TICK_S)

    @property
    def clock_known(self) -> bool:
        return self._clock.uncertainty_s is not None

    def ask(self, line: Transport) -> None:
        """Ask for the board's clock a few times; a board that does not answer is timed by its arrivals."""
        now_s = line.now_s()
        if self.asked < ASK_COUNT and now_s >= self._ask_at_s:
            self._sent_s, self._ask_at_s = now_s, now_s + ASK_EVERY_S
            self.asked += 1
            line.write(TIME_REQUEST)

    def answered(self, told: TimeTold, received_s: float, back_s: float, to_s: float) -> None:
        if self._sent_s is None:
            return
        until_s = received_s - back_s
        self._clock.exchange(min(self._sent_s + to_s, until_s), self._time(told.time_us) * TICK_S, until_s)
        self._sent_s = None

    def host_s(self, arrival: _Arrival) -> float | None:
        """The host's clock at a reading; None where the board's clock was set anew."""
        self._clock.least_delay_s = arrival.transfer_s
        device_s = self._time(arrival.reading.time_us) * TICK_S
        return self._clock.host_s(device_s) if self._clock.arrival(device_s, arrival.received_s) else None
