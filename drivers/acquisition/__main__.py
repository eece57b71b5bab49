"""The acquisition process: ``python -m drivers.acquisition FD``, started by `feed.AcquisitionFeed`."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections import deque
from contextlib import ExitStack, suppress
from multiprocessing.connection import Connection
from typing import Any

from drivers.acquisition.feed import Job, connection_from
from drivers.acquisition.messages import Ended, Health, Packer
from drivers.acquisition.pump import Pump
from drivers.host_clock import HostClock
from drivers.writers.recorder import Recorder
from mfslam.types import MfslamError

HEALTH_EVERY_S = 0.5
MOST_WAITING = 20_000  # a reader who is minutes behind misses the oldest; the recording has them


class Outbox:
    """Sends from a thread of its own: a reader that stalls holds nothing up."""

    def __init__(self, line: Connection) -> None:
        self._line = line
        self._waiting: deque[Any] = deque()
        self._wake = threading.Condition()
        self._closing = False
        self.dropped = 0
        self.gone = False
        self._thread = threading.Thread(target=self._send, daemon=True)
        self._thread.start()

    def put(self, item: Any, whatever: bool = False) -> None:
        """``whatever`` the backlog: lasers and last words are never left out."""
        with self._wake:
            if len(self._waiting) >= MOST_WAITING and not whatever:
                self.dropped += 1
                return
            self._waiting.append(item)
            self._wake.notify()

    def close(self, timeout_s: float) -> None:
        with self._wake:
            self._closing = True
            self._wake.notify()
        self._thread.join(timeout_s)

    def _send(self) -> None:
        while True:
            with self._wake:
                self._wake.wait_for(lambda: self._waiting or self._closing)
                if not self._waiting:
                    return
                item = self._waiting.popleft()
            try:
                self._line.send(item)
            except OSError:
                self.gone = True
                return


def main(fd: int) -> int:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    line = connection_from(fd)
    job: Job = line.recv()
    stop = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: stop.set())
    threading.Thread(target=_listen, args=(line, stop), daemon=True).start()
    outbox = Outbox(line)
    error, findings = None, []
    try:
        findings = _acquire(job, outbox, stop)
    except MfslamError as trouble:
        error = str(trouble)
    outbox.put(Ended(error, findings), whatever=True)
    outbox.close(10.0)
    return 0 if error is None else 1


def _listen(line: Connection, stop: threading.Event) -> None:
    """Any word is the wish to end; so is the silence of one who has died."""
    with suppress(EOFError, OSError):
        line.recv()
    stop.set()


def _acquire(job: Job, outbox: Outbox, stop: threading.Event) -> list[tuple[str, str, str, int]]:
    packer = Packer()
    with ExitStack() as stack:
        sensors = job.sources.open(job.config, HostClock(), stack)
        recorder = None if job.output is None else Recorder(job.output, job.config)
        pump = Pump(sensors, recorder)
        told_s = 0.0
        with pump:
            while not stop.is_set():
                message = pump.poll(HEALTH_EVERY_S)
                if message is not None:
                    _forward(packer.pack(message), outbox)
                if time.monotonic() - told_s > HEALTH_EVERY_S:
                    told_s = time.monotonic()
                    figures = [sensor.health.as_json() for sensor in sensors]
                    outbox.put(Health(figures, pump.recording_error, outbox.dropped))
            pump.stop()
            for message in pump.rest():
                _forward(packer.pack(message), outbox)
    return [(code, f.text, f.first_where, f.count) for code, f in pump.findings]


def _forward(items: list[Any], outbox: Outbox) -> None:
    for item in items:
        outbox.put(item, whatever=isinstance(item, tuple) and len(item) == 2)


if __name__ == "__main__":
    status = main(int(sys.argv[1]))
    sys.stdout.flush()
    os._exit(status)  # a thread that waits for a device must not keep us
