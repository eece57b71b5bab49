"""Stamps on the host's wall clock that no one who sets that clock can bend."""

from __future__ import annotations

import time


class HostClock:
    """Wall clock at the start, going on with the clock that is never set (`time.monotonic`)."""

    def __init__(self, now_s: float | None = None, wall_ns: int | None = None) -> None:
        self._start_s = time.monotonic() if now_s is None else now_s
        self._wall_ns = time.time_ns() if wall_ns is None else wall_ns

    def stamp_ns(self, host_s: float) -> int:
        """Wall time, int ns since 1970, of an instant of the monotonic clock."""
        return self._wall_ns + round((host_s - self._start_s) * 1e9)
