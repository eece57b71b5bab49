"""Stamps that lie: clocks that jump within a log, scans that are handed over in bursts, or stamped a little late or early."""

from __future__ import annotations

from array import array
from collections import deque
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from mfslam.types import Findings, FloatArray, Message

BACK_S, AHEAD_S = 1.0, 5.0  # a stamp is held to jump beyond these; hosts are seen to mix up less
REMEMBERED = 128  # stamps that tell the usual time between two
LEAST_KNOWN = 4
BURST_SHARE = 0.25  # of the usual time: closer together, scans were handed over at once
LEAST_STEADY = 32  # scans that tell whether a laser turns steadily
PAUSE_S = 2.0  # after which a laser's turn is not known any more


@dataclass(eq=False, slots=True)
class _Source:
    """Messages of one kind: seconds on the common time line."""

    offset_ns: int  # from the log's clock to the time line
    recent_s: deque[float] = field(default_factory=lambda: deque(maxlen=REMEMBERED))
    seen_at_s: float = 0.0  # how far the log was at the latest one

    def usual_s(self) -> float:
        """Mean time between messages: single ones prove nothing where they come in bursts."""
        count = len(self.recent_s) - 1
        return (self.recent_s[-1] - self.recent_s[0]) / count if count > 0 else 0.0


class StampClock:
    """One time line for all messages, in seconds from the first; log order is kept where clocks jump.

    A kind of messages jumps when its stamp goes back by more than ``BACK_S``, or ahead by ``AHEAD_S`` more
    than the other kinds have gone meanwhile. Its time then goes on from before, by its usual step; other
    kinds that jump alike follow.
    """

    def __init__(self, findings: Findings) -> None:
        self._findings = findings
        self._sources: dict[type, _Source] = {}
        self._first_ns = 0
        self._latest_offset_ns: int | None = None
        self._now_s = 0.0

    def place(self, message: Message) -> tuple[float, float]:
        """Time of the next message (s), and by how much its clock was found to jump before it (s, else 0)."""
        stamp_ns = message.stamp_ns
        if self._latest_offset_ns is None:
            self._first_ns = self._latest_offset_ns = stamp_ns
        source = self._sources.get(type(message))
        jump_s = 0.0
        if source is None:
            source = self._sources[type(message)] = _Source(self._latest_offset_ns)
        else:
            jump_s = self._jump_s(source, stamp_ns)
        time_s = (stamp_ns - source.offset_ns) * 1e-9
        source.recent_s.append(time_s)
        source.seen_at_s = self._now_s = max(self._now_s, time_s)
        return time_s, jump_s

    def on_time_line(self, message: Message) -> int:
        """Stamp (ns) of a message that was placed, as the log's clock would have had it without its jumps."""
        return message.stamp_ns - self._sources[type(message)].offset_ns + self._first_ns

    def _jump_s(self, source: _Source, stamp_ns: int) -> float:
        assert self._latest_offset_ns is not None
        before_ns = source.offset_ns
        if self._goes_on(source, stamp_ns, before_ns):
            return 0.0
        if not self._goes_on(source, stamp_ns, self._latest_offset_ns):
            next_s = source.recent_s[-1] + source.usual_s()
            self._latest_offset_ns = stamp_ns - round(next_s * 1e9)
            jump_s = (self._latest_offset_ns - before_ns) * 1e-9
            self._findings.add(
                "clock-jump",
                "the log's clock jumps (or the log pauses): times go on from before, in the log's order",
                f"{stamp_ns * 1e-9:.6f} s, by {jump_s:+.3f} s",
            )
        source.offset_ns = self._latest_offset_ns
        return (source.offset_ns - before_ns) * 1e-9

    def _goes_on(self, source: _Source, stamp_ns: int, offset_ns: int) -> bool:
        step_s = (stamp_ns - offset_ns) * 1e-9 - source.recent_s[-1]
        return -BACK_S <= step_s <= AHEAD_S + self._now_s - source.seen_at_s


class ScanPace:
    """When scans were sensed that are handed over in bursts and stamped then, each later than it was.

    The last scan of a burst bears the least delay; those before it were sensed one usual step after another.
    """

    def __init__(self) -> None:
        self._stamps_s: deque[float] = deque(maxlen=REMEMBERED)
        self._sensed_s = 0.0
        self._together = 1  # scans of this burst so far
        self._longest = 1

    def sensed_s(self, stamp_s: float, next_gap_s: float | None) -> float:
        """Instant of the next scan, at most its stamp. ``next_gap_s``: from its stamp to that of the scan
        after it, None where that is not known."""
        self._stamps_s.append(stamp_s)
        count = len(self._stamps_s) - 1
        usual_s = (stamp_s - self._stamps_s[0]) / count if count >= LEAST_KNOWN else 0.0
        sensed_s = stamp_s
        if next_gap_s is not None and 0.0 <= next_gap_s < BURST_SHARE * usual_s:
            self._together += 1
            self._longest = max(self._longest, self._together)
            # scans lost before the burst are not made up
            earliest_s = stamp_s - (self._longest - 1) * usual_s
            sensed_s = min(stamp_s, max(self._sensed_s + usual_s, earliest_s))
        else:
            self._together = 1
        self._sensed_s = sensed_s
        return sensed_s


class SteadyPace:
    """When scans of a laser that turns steadily were sensed, however late or early its host stamped them.

    A line through the stamps around over the number of turns. Noise of the stamps alone scatters them about it with half
    the variance of the gaps between them, whereas a pace that wanders by itself leaves N / 15 of that over N scans.
    Stamps that scatter by more than a tenth of a turn leave the count of turns in doubt where scans are lost, and are mostly
    taken as they are.
    """

    def __init__(self) -> None:
        self._turns, self._stamps_s = array("d"), array("d")
        self._sensed_s = array("d")  # as found at once
        self._starts = [0]  # scans at which the turning is not known from before
        self._period_s = 0.0
        self.jitter_s = 0.0  # scatter of the stamps about the line; 0 where they are taken as they are

    def sensed_s(self, stamp_s: float) -> float:
        """Instant of the next scan, by the stamps before it."""
        count, turn = len(self._stamps_s), 0.0
        if count and not 0.0 <= stamp_s - self._stamps_s[-1] < PAUSE_S:
            self._starts.append(count)
        elif count:
            ahead = (stamp_s - self._sensed_s[-1]) / self._period_s if self._period_s > 0.0 else 1.0
            turn = self._turns[-1] + max(1, round(ahead))
        self._turns.append(turn)
        self._stamps_s.append(stamp_s)
        first = max(self._starts[-1], count + 1 - REMEMBERED)
        sensed_s, self._period_s, self.jitter_s = stamp_s, 0.0, 0.0
        if count + 1 - first >= LEAST_KNOWN:
            off_s, self._period_s = _about_line(
                np.array(self._turns[first:]), np.array(self._stamps_s[first:])
            )
            if _is_steady(off_s):
                sensed_s -= float(off_s[-1])
                self.jitter_s = float(np.sqrt(np.mean(off_s**2)))
        self._sensed_s.append(sensed_s)
        return sensed_s

    def settle(self) -> FloatArray:
        """(S,) by how much later than found so far each scan was sensed, by the stamps before and after it."""
        turns, stamps_s, sensed_s = map(np.array, (self._turns, self._stamps_s, self._sensed_s))
        out, half = np.zeros(len(turns)), REMEMBERED // 2
        for start, end in pairwise([*self._starts, len(turns)]):
            for n in range(start, end):
                low = max(start, min(n - half, end - REMEMBERED))
                some = slice(low, min(low + REMEMBERED, end))
                if some.stop - low < LEAST_STEADY:
                    break
                off_s, _ = _about_line(turns[some], stamps_s[some])
                if _is_steady(off_s):
                    out[n] = stamps_s[n] - off_s[n - low] - sensed_s[n]
        self._sensed_s = array("d", sensed_s + out)
        return out


def _about_line(turns: FloatArray, stamps_s: FloatArray) -> tuple[FloatArray, float]:
    """How far stamps (N,) lie from their best line over the turns (N,), and its slope."""
    spread, from_last_s = turns - turns.mean(), stamps_s - stamps_s[-1]
    period_s = float(spread @ from_last_s / (spread @ spread))
    return from_last_s - from_last_s.mean() - period_s * spread, period_s


def _is_steady(off_s: FloatArray) -> bool:
    """Whether stamps scatter so (N,) about a line because of noise of their own."""
    return len(off_s) >= LEAST_STEADY and bool(np.mean(off_s**2) < np.mean(np.diff(off_s) ** 2))
