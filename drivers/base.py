"""What every source of messages is: one Protocol, one registry (`drivers.logs.open_log`)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol, Self

from mfslam.types import Findings, Message, MfslamError


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
