"""Acquisition and recording in a process of their own; here is the end that whoever maps holds."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from types import TracebackType
from typing import Self

from drivers.acquisition.messages import Ended, Health, Unpacker
from drivers.acquisition.sources import Sources
from drivers.own_process import OwnProcess
from mfslam.config import Config
from mfslam.types import Findings, Message, MfslamError

LOOK_UP_S = 0.5
LEAVE_S = 15.0  # a full disk takes its time


@dataclass(frozen=True)
class Job:
    """What the process is told to do."""

    sources: Sources
    config: Config
    output: Path | None


class AcquisitionFeed:
    """A `drivers.base.Feed` from live sensors.

    The process records whatever comes, whether or not anyone reads here. Killed, it leaves a recording that
    misses at most the last second. When we are killed, it finishes the recording and ends.
    """

    def __init__(self, sources: Sources, config: Config, output: Path | None = None) -> None:
        self.findings = Findings()
        self.health = Health([])
        self.output = output
        self._unpacker = Unpacker()
        self._over = False
        self.process = OwnProcess("drivers.acquisition")
        self._line = self.process.line
        self._line.send(Job(sources, config, output))

    def poll(self, timeout_s: float) -> Message | None:
        """See `drivers.base.Feed`."""
        if self._over or not self._line.poll(timeout_s):
            return None
        try:
            item = self._unpacker.unpack(self._line.recv())
        except (EOFError, ConnectionError, OSError):
            self._over = True
            raise MfslamError(self._obituary()) from None
        if isinstance(item, Health):
            self.health = item
            return None
        if isinstance(item, Ended):
            self._over = True
            for code, text, where, count in item.findings:
                self.findings.add(code, text, where, count)
            if item.error is not None:
                raise MfslamError(item.error)
            return None
        return item  # type: ignore[no-any-return]

    @property
    def over(self) -> bool:
        return self._over

    def __iter__(self) -> Iterator[Message]:
        while not self._over:
            message = self.poll(LOOK_UP_S)
            if message is not None:
                yield message

    def stop(self) -> None:
        """Ask for the end; what is still on its way can be read until `over`."""
        if not self._over:
            try:
                self._line.send("stop")
            except OSError:
                return

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()
        try:
            for _ in self:
                continue
        except MfslamError as trouble:
            if kind is None:
                self.findings.add("acquisition-failed", str(trouble))
        finally:
            self.process.end(LEAVE_S)

    def _obituary(self) -> str:
        how = self.process.how_it_ended()
        kept = "" if self.output is None else f"; {self.output} holds all but the last second"
        return f"the acquisition process {how}{kept}"


def connection_from(fd: int) -> Connection:
    """The child's end of the line."""
    os.set_inheritable(fd, False)
    return Connection(fd)
