"""How long a scan waits for its pose."""

from __future__ import annotations

import sys
import time
from collections import deque
from types import TracebackType
from typing import Self

import numpy as np

NEWEST = 20_000  # scans that the percentiles are of
SWITCH_S = 0.0005  # that another thread may keep Python's lock from the one that places a scan


def switch_quickly() -> None:
    """Have a thread that wants Python's lock wait for less than its usual 5 ms. Of the whole process: for commands."""
    sys.setswitchinterval(SWITCH_S)


class Latency:
    """Of scans placed inside its ``with`` blocks: wall time, and the processor's time, without what others had of it."""

    def __init__(self) -> None:
        self._wall_s: deque[float] = deque(maxlen=NEWEST)
        self._cpu_s: deque[float] = deque(maxlen=NEWEST)
        self._worst_s = self._worst_cpu_s = 0.0
        self._began_s = self._cpu_began_s = 0.0

    def __enter__(self) -> Self:
        self._began_s, self._cpu_began_s = time.perf_counter(), time.thread_time()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._wall_s.append(time.perf_counter() - self._began_s)
        self._cpu_s.append(time.thread_time() - self._cpu_began_s)
        self._worst_s = max(self._worst_s, self._wall_s[-1])
        self._worst_cpu_s = max(self._worst_cpu_s, self._cpu_s[-1])

    def as_ms(self) -> dict[str, float]:
        """``median``, ``p99``, ``worst``, and of the processor alone ``cpu_p99``, ``cpu_worst``; nothing before the first."""
        if not self._wall_s:
            return {}
        median, p99 = np.percentile(np.array(self._wall_s), [50.0, 99.0])
        cpu_p99 = float(np.percentile(np.array(self._cpu_s), 99.0))
        told = {"median": float(median), "p99": float(p99), "worst": self._worst_s}
        told |= {"cpu_p99": cpu_p99, "cpu_worst": self._worst_cpu_s}
        return {name: 1e3 * seconds for name, seconds in told.items()}
