"""What a person sees of a live run in the terminal, and how he ends it."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable
from types import FrameType
from typing import Any, Self

TELL_EVERY_S = 10.0  # where the output is no terminal


class Ends:
    """Ctrl-C and SIGTERM ask for a good end; ``at_once`` is what a second one does."""

    def __init__(self, at_once: Callable[[], None] | None = None) -> None:
        self.asked = False
        self._at_once = at_once

    def __enter__(self) -> Self:
        self._before = {n: signal.signal(n, self._ask) for n in (signal.SIGINT, signal.SIGTERM)}
        return self

    def __exit__(self, *_: object) -> None:
        for number, before in self._before.items():
            signal.signal(number, before)

    def _ask(self, number: int, frame: FrameType | None) -> None:
        if self.asked and self._at_once is not None:
            self._at_once()
        self.asked = True


class StatusLine:
    """On standard error: one line that is renewed, or one now and then where that is no terminal."""

    def __init__(self, quiet: bool) -> None:
        self._quiet, self._terminal = quiet, sys.stderr.isatty()
        self._next_s = 0.0
        self._shown = 0

    def tell(self, text: str) -> None:
        """A line of its own."""
        self.close()
        if not self._quiet:
            print(text, file=sys.stderr, flush=True)

    def show(self, text: Callable[[], str]) -> None:
        """Renew the line, if it is time."""
        if self._quiet or time.monotonic() < self._next_s:
            return
        self._next_s = time.monotonic() + (0.5 if self._terminal else TELL_EVERY_S)
        line = text()
        if not self._terminal:
            print(line, file=sys.stderr, flush=True)
            return
        width = os.get_terminal_size(sys.stderr.fileno()).columns - 1
        line = line if len(line) <= width else f"{line[: width - 3]}..."
        print(f"\r{line:<{self._shown}}", end="", file=sys.stderr, flush=True)
        self._shown = len(line)

    def close(self) -> None:
        if self._shown:
            print(file=sys.stderr)
            self._shown = 0


def describe(health: dict[str, Any]) -> str:
    """One sensor (`SensorHealth.as_json`) in a few words."""
    if not health["connected"]:
        return f"{health['name']}: {health['text']}"
    errors = sum(health["errors"].values())
    told = f"{health['name']}: {health['rate_hz']:.1f} Hz, {health['delay_s'] * 1e3:.0f} ms late"
    return told + (f", {errors} errors" if errors else "")
