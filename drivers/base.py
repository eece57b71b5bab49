"""What every source of messages is: one Protocol, one registry (`drivers.logs.open_log`)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol, Self

from mfslam.types import Findings, Message, MfslamError


class SensorTrouble(MfslamError):
    """A sensor does not answer, or says that it is broken."""


class NoScans(MfslamError):
    """The log was read, or looked through, and holds no laser scan that can be used."""


@dataclass(frozen=True)
class TopicChoice:
    """Names that settle which of several sources is read. None: found by type.

    A name is a ROS topic, or the message's word in a text log (``RLASER``).
    """

    scan: str | None = None
    odometry: str | None = None
    imu: str | None = None
    wheels: str | None = None


@dataclass
class LogInfo:
    """What a log says of itself, known after it was opened.

    ``details`` of every driver: ``messages`` (count per message name or topic), ``scan_source`` (the name
    of the one that is read), ``odometry`` ("moving", "present", "constant", "none").
    """

    path: Path
    format: str
    details: dict[str, Any] = field(default_factory=dict)


class Log(Protocol):
    """A recorded log: a context manager that yields typed messages in log order, once.

    ``findings`` fills up while iterating: everything odd, dropped or repaired is counted there.
    """

    info: LogInfo
    findings: Findings

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...

    def __iter__(self) -> Iterator[Message]: ...

    def progress(self) -> float:
        """Share of the log that was read, 0 to 1."""
        ...


@dataclass
class SensorHealth:
    """How a live sensor fares; its driver keeps it, whoever likes may read it.

    ``rate_hz``, ``delay_s``: of the latest messages, ``delay_s`` from the stamp to the arrival. ``errors``:
    what went wrong, counted by kind. ``reconnects``: times the line was lost and found again. ``text``: what
    it is doing now, in words. ``advice``: what its user could do better.
    """

    name: str
    connected: bool = False
    messages: int = 0
    rate_hz: float = 0.0
    delay_s: float = 0.0
    last_stamp_ns: int = 0
    reconnects: int = 0
    errors: Counter[str] = field(default_factory=Counter)
    text: str = "starting"
    advice: str = ""
    _pace_s: float = 0.0

    def saw(self, stamp_ns: int, delay_s: float) -> None:
        """A good message came."""
        step_s = (stamp_ns - self.last_stamp_ns) * 1e-9
        if self.messages and 0.0 < step_s < 10.0:
            self._pace_s += 0.1 * (step_s - self._pace_s) if self._pace_s else step_s
            self.rate_hz = 1.0 / self._pace_s
        self.delay_s += 0.1 * (delay_s - self.delay_s) if self.messages else delay_s
        self.messages += 1
        self.last_stamp_ns = stamp_ns
        self.connected = True
        self.text = "running"

    def lost(self, why: str) -> None:
        """The line is gone, or silent."""
        self.connected, self.rate_hz, self._pace_s, self.text = False, 0.0, 0.0, why

    def as_json(self) -> dict[str, Any]:
        return {
            "name": self.name,
            "connected": self.connected,
            "messages": self.messages,
            "rate_hz": round(self.rate_hz, 3),
            "delay_s": round(self.delay_s, 5),
            "reconnects": self.reconnects,
            "errors": {kind: n for kind, n in sorted(self.errors.items()) if n},
            "text": self.text,
            "advice": self.advice,
        }


class Sensor(Protocol):
    """A live sensor. Whoever reads it gives it a thread of its own: `messages` waits for the device."""

    health: SensorHealth

    def messages(self, stopped: Callable[[], bool]) -> Iterator[Message]:
        """Messages as they come, stamped on the host's clock, until ``stopped``. An unplugged sensor is waited
        for. Raises MfslamError where it cannot be had at all, at the start."""
        ...


class Feed(Protocol):
    """Messages from elsewhere, as they come: what a live engine reads. A context manager; leaving it ends the
    acquisition and waits for its recording to be whole.

    ``findings`` is complete after the end. ``health`` holds the latest figures (`SensorHealth.as_json`) of
    every sensor, and is renewed while messages are polled.
    """

    findings: Findings
    health: Any

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...

    @property
    def over(self) -> bool:
        """Nothing will come any more."""
        ...

    def poll(self, timeout_s: float) -> Message | None:
        """The next message in order of arrival; None if there is none in time, or it is over. Raises MfslamError
        in one line when a sensor cannot be had or the acquisition has died."""
        ...

    def __iter__(self) -> Iterator[Message]:
        """Messages until it is over."""
        ...

    def stop(self) -> None:
        """Ask for the end; what is on its way still comes."""
        ...
