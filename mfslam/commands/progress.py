"""What a person sees while a run goes on."""

from __future__ import annotations

import sys
import time
from typing import Any


class Progress:
    """A bar over the log with the real-time factor; silent when ``quiet``."""

    def __init__(self, quiet: bool) -> None:
        self.quiet = quiet
        self._start_s = time.monotonic()
        self._last_s = 0.0
        self._bar: Any = None

    def tell(self, text: str) -> None:
        """One line about what happens now."""
        self.close()
        if not self.quiet:
            print(text, file=sys.stderr, flush=True)

    def start(self, title: str) -> None:
        self._start_s = time.monotonic()
        if self.quiet:
            return
        from tqdm import tqdm

        self._bar = tqdm(
            total=100.0,
            desc=title,
            bar_format="{desc} {percentage:3.0f}% |{bar:30}| {elapsed} {postfix}",
            mininterval=0.2 if sys.stderr.isatty() else 5.0,
        )

    def update(self, share: float, log_s: float) -> None:
        """``share`` of the log that was read, ``log_s`` seconds of it."""
        now = time.monotonic()
        if self._bar is None or now - self._last_s < 0.2:
            return
        self._last_s = now
        factor = log_s / max(now - self._start_s, 1e-3)
        self._bar.set_postfix_str(f"{factor:.0f} x real time", refresh=False)
        self._bar.update(100.0 * share - self._bar.n)

    def close(self) -> None:
        if self._bar is not None:
            self._bar.close()
            self._bar = None
