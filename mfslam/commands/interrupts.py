"""Ctrl-C while a run goes on: what is mapped so far is worth keeping."""

from __future__ import annotations

import signal
from types import FrameType, TracebackType
from typing import Any, Self


class Interrupts:
    """Counts Ctrl-C inside the block instead of breaking off: the engine is asked to stop between messages
    or stages, where its state is whole. The third one raises KeyboardInterrupt at once."""

    PATIENCE = 2

    def __init__(self) -> None:
        self.count = 0
        self._before: Any = None

    def __enter__(self) -> Self:
        self._before = signal.signal(signal.SIGINT, self._count)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        signal.signal(signal.SIGINT, self._before)

    def _count(self, number: int, frame: FrameType | None) -> None:
        self.count += 1
        if self.count > self.PATIENCE:
            raise KeyboardInterrupt
