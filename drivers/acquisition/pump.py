"""Sensors, each in its own thread, into one stream of messages in order of arrival, and into the recording."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from queue import Empty, SimpleQueue
from types import TracebackType
from typing import Self

from drivers.base import Sensor
from drivers.writers.recorder import Recorder
from mfslam.types import Findings, Message, MfslamError

LOOK_UP_S = 0.1
LEAVE_S = 3.0


class Pump:
    """Runs the sensors inside a ``with`` block; `poll` gives what has come.

    A message is recorded before anyone sees it. A recording that fails (disk full) is told in ``findings`` and
    in ``recording_error``; the sensors go on. ``findings`` is complete once the block has ended.
    """

    def __init__(self, sensors: Sequence[Sensor], recorder: Recorder | None = None) -> None:
        self.sensors, self.recorder = sensors, recorder
        self.findings = Findings()
        self.recording_error: str | None = None
        self._queue: SimpleQueue[Message | MfslamError] = SimpleQueue()
        self._stop = threading.Event()
        # threads of their own: neither a slow disk nor a slow reader may keep a serial port waiting
        self._threads = [
            threading.Thread(target=self._read, args=(sensor,), daemon=True, name=sensor.health.name)
            for sensor in sensors
        ]

    def __enter__(self) -> Self:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()
        try:
            for _ in self.rest():
                continue
        finally:
            self._close()

    def stop(self) -> None:
        """Ask the sensors to end; `rest` has what they still gave."""
        self._stop.set()

    def _read(self, sensor: Sensor) -> None:
        try:
            for message in sensor.messages(self._stop.is_set):
                self._queue.put(message)
        except MfslamError as error:
            self._queue.put(error)
        except Exception as error:  # a driver's bug must not end in silence
            self._queue.put(MfslamError(f"{sensor.health.name}: {type(error).__name__}: {error}"))

    def poll(self, timeout_s: float) -> Message | None:
        """The next message, None if there is none in time. Raises MfslamError for a sensor that cannot be had."""
        try:
            item = self._queue.get(timeout=min(timeout_s, LOOK_UP_S))
        except Empty:
            self._record(None)
            return None
        if isinstance(item, MfslamError):
            raise item
        self._record(item)
        return item

    def rest(self) -> Iterator[Message]:
        """What came before the sensors had stopped."""
        for thread in self._threads:
            thread.join(LEAVE_S)
        while not self._queue.empty():
            item = self._queue.get()
            if not isinstance(item, MfslamError):
                self._record(item)
                yield item

    def _record(self, message: Message | None) -> None:
        if self.recorder is None or self.recording_error is not None:
            return
        try:
            if message is None:
                self.recorder.tick()
            else:
                self.recorder.add(message)
        except MfslamError as error:
            self.recording_error = str(error)
            self.findings.add("recording-stopped", str(error))

    def _close(self) -> None:
        for sensor in self.sensors:
            health = sensor.health
            for kind, count in sorted(health.errors.items()):
                if count:
                    code = f"sensor-{kind}"
                    code = f"{code}-{health.name}" if code in self.findings else code
                    self.findings.add(code, f"{health.name}: {kind}", count=count)
            if health.advice:
                self.findings.add(f"advice-{health.name}", f"{health.name}: {health.advice}")
            if health.reconnects:
                text = f"{health.name}: the line was lost and found again"
                self.findings.add(f"reconnect-{health.name}", text, count=health.reconnects)
        if self.recorder is not None:
            self.findings.merge(self.recorder.findings)
            if self.recording_error is None:
                try:
                    self.recorder.close()
                except MfslamError as error:
                    self.recording_error = str(error)
                    self.findings.add("recording-stopped", str(error))
