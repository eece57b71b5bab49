"""What every live sensor on a line has in common: it is found, lost and found again."""

from __future__ import annotations

import contextlib
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator

from drivers.base import SensorHealth, SensorTrouble
from drivers.host_clock import HostClock
from drivers.transport import Transport, Unplugged, open_transport
from mfslam.types import Message

PAUSE_S = 0.5  # between two attempts to find a lost sensor again
LOOK_UP_S = 0.2  # how often a wait looks up whether it is still wanted


class Stopped(Exception):
    """Whoever listens has had enough."""


class NoAnswer(SensorTrouble):
    """Nothing intelligible comes back."""


class LiveSensor(ABC):
    """A `drivers.base.Sensor` on a serial port or TCP connection at ``address``.

    ``clock`` makes the stamps. ``open_line`` and ``pause`` are what tests replace.
    """

    def __init__(
        self,
        name: str,
        address: str,
        baud: int,
        clock: HostClock | None = None,
        open_line: Callable[[str, int], Transport] = open_transport,
        pause: Callable[[float], None] = time.sleep,
    ) -> None:
        self.health = SensorHealth(name)
        self.clock = clock or HostClock()
        self.baud = baud
        self._address, self._open_line, self._pause = address, open_line, pause
        self._was_there = False

    def messages(self, stopped: Callable[[], bool]) -> Iterator[Message]:
        """See `drivers.base.Sensor`."""
        while not stopped():
            try:
                line = self._open_line(self._address, self.baud)
            except Unplugged as error:
                self._lost(str(error))
            else:
                yield from self._until_lost(line, stopped)
            if not stopped():
                self._pause(PAUSE_S)

    def _until_lost(self, line: Transport, stopped: Callable[[], bool]) -> Iterator[Message]:
        try:
            for message in self._talk(line, stopped):
                self._was_there = True
                yield message
        except Stopped:
            return
        except (Unplugged, SensorTrouble) as error:
            self._lost(str(error))
        finally:
            with contextlib.suppress(OSError):
                self._take_leave(line)
            line.close()

    def _lost(self, why: str) -> None:
        """Remember it; at the start, when the sensor was never there, give up."""
        why = why.removeprefix(f"{self._address}: ")
        if not self._was_there:
            raise SensorTrouble(f"{self.health.name}: {why}")
        if self.health.connected:
            self.health.reconnects += 1
        self.health.lost(why)

    @abstractmethod
    def _talk(self, line: Transport, stopped: Callable[[], bool]) -> Iterator[Message]:
        """Messages from one line that was just opened. Raises Stopped, Unplugged, SensorTrouble."""

    def _take_leave(self, line: Transport) -> None:
        """Last words on a line that is left, where there are any."""
        return
