"""A sensor's own clock, told on the host's: offset and drift, from what is exchanged and from what arrives.

All times are float seconds. The device's are unwrapped ticks of its counter; the host's are of a clock that
never jumps (`time.monotonic`).
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np

BUCKET_S = 5.0  # of what arrives in this time, the promptest tells
REMEMBERED = 120  # buckets: 10 minutes
LEAST_BUCKETS = 4
MAX_DRIFT = 1e-3  # s per s: no crystal is worse
AHEAD_S, LATE_S, LATE_COUNT = 0.25, 5.0, 20  # beyond: the device's clock was set anew


class Unwrapped:
    """A counter of ``bits`` bits that starts over, as one that does not."""

    def __init__(self, bits: int) -> None:
        self._turn = 1 << bits
        self._last: int | None = None

    def __call__(self, count: int) -> int:
        """The counter nearest to the last one; steps of up to half a turn either way are understood."""
        if self._last is None:
            self._last = count
        else:
            step = (count - self._last) % self._turn
            self._last += step if step < self._turn // 2 else step - self._turn
        return self._last


@dataclass
class ClockSync:
    """Maps a device's clock to the host's: host = device + offset(device).

    ``tick_s``: resolution of the device's clock, which rounds down. ``least_delay_s``: what passes at least
    between the instant that a message tells and its arrival; only used until an `exchange` told better.
    """

    tick_s: float = 0.0
    least_delay_s: float = 0.0
    drift: float = 0.0
    _bounds: tuple[float, float] | None = None  # of the offset, from exchanges
    _exchanged_at_s: float = 0.0
    _delay_s: float | None = None  # of the promptest arrivals, once known
    _buckets: deque[tuple[float, float]] = field(default_factory=lambda: deque(maxlen=REMEMBERED))
    _bucket: tuple[float, float, float] | None = None  # start, device time and lag of its promptest
    _line: tuple[float, float] | None = None  # device time, lag there
    _late: int = 0

    def exchange(self, sent_s: float, device_s: float, received_s: float) -> None:
        """The device was asked at ``sent_s`` and told ``device_s`` by ``received_s``, transfer times taken off.

        The offset lies between the bounds of all exchanges: several at different phases of the tick tell
        it better than a tick.
        """
        low, high = sent_s - device_s - self.tick_s, received_s - device_s
        if self._bounds is not None:
            both = max(low, self._bounds[0]), min(high, self._bounds[1])
            low, high = both if both[0] <= both[1] else (low, high)  # contradiction: the newest counts
        self._bounds, self._exchanged_at_s = (low, high), device_s

    @property
    def uncertainty_s(self) -> float | None:
        """Half width of what exchanges leave open; None without any."""
        return None if self._bounds is None else 0.5 * (self._bounds[1] - self._bounds[0])

    def arrival(self, device_s: float, received_s: float) -> bool:
        """A message that tells ``device_s`` was received. False where that cannot be: the device's clock was
        set anew, and a new ClockSync is due."""
        lag = received_s - device_s
        if self._bucket is not None or self._line is not None:
            excess = lag - self._lag(device_s)
            self._late = self._late + 1 if excess > LATE_S else 0
            if excess < -AHEAD_S or self._late >= LATE_COUNT:
                return False
        if self._bucket is None:
            self._bucket = (device_s, device_s, lag)
        elif device_s - self._bucket[0] >= BUCKET_S:
            self._buckets.append(self._bucket[1:])
            self._bucket = (device_s, device_s, lag)
            self._fit()
        elif lag < self._bucket[2]:
            self._bucket = (self._bucket[0], device_s, lag)
        return True

    def host_s(self, device_s: float) -> float:
        """The host's clock at an instant of the device's clock."""
        if self._bounds is not None and self._delay_s is None:
            return device_s + 0.5 * sum(self._bounds)
        delay = self.least_delay_s if self._delay_s is None else self._delay_s
        return device_s + self._lag(device_s) - delay

    def _lag(self, device_s: float) -> float:
        """Arrival minus device time of the promptest messages."""
        if self._line is not None:
            return self._line[1] + self.drift * (device_s - self._line[0])
        if self._bucket is not None:
            return min([self._bucket[2], *(lag for _, lag in self._buckets)])
        return self.least_delay_s

    def _fit(self) -> None:
        """A line through the promptest arrivals: median of slopes, since a stalled host delays whole buckets."""
        if len(self._buckets) < LEAST_BUCKETS:
            return
        at, lag = np.array(self._buckets).T
        i, j = np.triu_indices(len(at), 1)
        slope = float(np.median((lag[j] - lag[i]) / (at[j] - at[i])))
        self.drift = min(max(slope, -MAX_DRIFT), MAX_DRIFT)
        level = float(np.min(lag - self.drift * (at - at[-1])))  # nothing arrives before it is sent
        self._line = (float(at[-1]), level)
        if self._bounds is not None and self._delay_s is None:
            self._delay_s = self._lag(self._exchanged_at_s) - 0.5 * sum(self._bounds)
