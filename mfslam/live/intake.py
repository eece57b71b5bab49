"""Messages on their way to the engine: from sensors as they come, or from a log at a chosen pace."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator

from drivers.base import Feed, Log
from mfslam.live.engine import LiveSlam
from mfslam.live.pressure import POSE_LATE_S
from mfslam.types import FloatArray, Message, Scan

AHEAD_SCANS = 200  # that a replay at full speed may be ahead of the map


class Intake:
    """Hands the engine what waits, oldest first; scans that waited too long go into the map without a pose."""

    def __init__(self, slam: LiveSlam) -> None:
        self.slam = slam
        self._waiting: deque[tuple[float, Message]] = deque()  # when it came

    def put(self, message: Message) -> None:
        self._waiting.append((time.monotonic(), message))

    def take(self) -> FloatArray | None:
        """Feed the oldest message that waits; of a scan that was placed its pose (3,)."""
        if not self._waiting:
            return None
        came_s, message = self._waiting.popleft()
        late_s = time.monotonic() - came_s
        if not isinstance(message, Scan) or late_s < POSE_LATE_S or not self._newer_waits():
            return self.slam.feed(message)
        self.slam.pressure.left_out(late_s)
        return self.slam.feed(message, place=False)

    def _newer_waits(self) -> bool:
        return any(isinstance(message, Scan) for _, message in self._waiting)

    def __len__(self) -> int:
        return len(self._waiting)


def from_sensors(feed: Feed, intake: Intake, timeout_s: float = 0.05) -> None:
    """Take over whatever the sensors have told by now; waits a little where nothing has come. Raises MfslamError."""
    message = feed.poll(0.0 if len(intake) else timeout_s)
    while message is not None:
        intake.put(message)
        message = feed.poll(0.0)


def paced(log: Log, speed: float | None) -> Iterator[Message]:
    """A log's messages, each when its stamp comes at ``speed`` times the pace of the recording; None: at once.

    Stamps that go back wait for nothing; a clock that jumps ahead is not waited for either.
    """
    started_s, first_ns, latest_ns = time.monotonic(), None, 0
    for message in log:
        if speed is not None:
            if first_ns is None:
                first_ns = latest_ns = message.stamp_ns
            if message.stamp_ns - latest_ns > 10_000_000_000:
                first_ns += message.stamp_ns - latest_ns
            latest_ns = max(latest_ns, message.stamp_ns)
            pause_s = started_s + (message.stamp_ns - first_ns) * 1e-9 / speed - time.monotonic()
            if pause_s > 0.0:
                time.sleep(pause_s)
        yield message
