"""What every source of messages is: one Protocol, one registry (`drivers.logs.open_log`)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol, Self

from mfslam.types import Findings, Message


@dataclass
class LogInfo:
    """What a log says of itself, known after it was opened (details) or read (findings)."""

    path: Path
    format: str
    details: dict[str, Any] = field(default_factory=dict)


class Log(Protocol):
    """A recorded log: a context manager that yields typed messages in log order.

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
