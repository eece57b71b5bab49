"""What a person sees while a run goes on."""

from __future__ import annotations

import shutil
import sys
import time
from typing import Any

_LINE_EVERY_S = 10.0  # where the output is no terminal


class Progress:
    """Stages as lines and a bar over the log with the real-time factor, on standard error.

    Where that is no terminal, the bar is a line every ten seconds. Silent when ``quiet``.
    """

    def __init__(self, quiet: bool) -> None:
        self.quiet = quiet
        self._title = ""
        self._start_s = self._last_s = 0.0
        self._bar: Any = None

    def tell(self, text: str) -> None:
        """One line about what happens now."""
        self.close()
        if not self.quiet:
            print(text, file=sys.stderr, flush=True)

    def start(self, title: str) -> None:
        self._title = title
        self._start_s = self._last_s = time.monotonic()
        if self.quiet:
            return
        if not sys.stderr.isatty():
            self.tell(f"{title} ...")
            return
        from tqdm import tqdm

        bar_format = "{desc} {percentage:3.0f} % |{bar:30}| {elapsed}{postfix}"
        size = shutil.get_terminal_size()  # tqdm itself draws nothing where a terminal tells no size
        self._bar = tqdm(
            total=100.0, desc=title, bar_format=bar_format, mininterval=0.0,
            ncols=min(100, size.columns), nrows=size.lines,
        )  # fmt: skip

    def update(self, share: float, log_s: float) -> None:
        """``share`` of the log that was read, ``log_s`` seconds of it."""
        now = time.monotonic()
        if self.quiet or now - self._last_s < (_LINE_EVERY_S if self._bar is None else 0.2):
            return
        self._last_s = now
        factor = f"{log_s / max(now - self._start_s, 1e-3):.0f} x real time"
        if self._bar is None:
            self.tell(f"{self._title}: {100.0 * share:.0f} %, {factor}")
            return
        self._bar.set_postfix_str(factor, refresh=False)
        self._bar.update(100.0 * share - self._bar.n)

    def close(self, complete: bool = False) -> None:
        """End the bar; ``complete``: the whole log was read."""
        if self._bar is None:
            return
        if complete:
            self._bar.update(100.0 - self._bar.n)
        self._bar.close()
        self._bar = None
