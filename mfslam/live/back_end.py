"""The process that maps: ``python -m mfslam.live FD``, started by `link.Link`. One thread, since it forks."""

from __future__ import annotations

import os
import pickle
import time
from collections import deque
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any

from drivers.acquisition.messages import Unpacker
from mfslam.kernels.warm_up import compile_once
from mfslam.live.mapper import Mapper
from mfslam.live.words import Corrected, Enough, Finish, Finished, Granted, Job, NewMap, Thin, Told, Wish
from mfslam.types import MfslamError

TELL_EVERY_S = 0.25
MOST_AT_ONCE = 200  # words that are taken from the line before the next is handled
REST = 1.5  # times as long as it took, before the map is refined anew beside the mapping
YOUNG = 0.5  # of the time since the first scan: a young map is drawn more often than it will be later


class _Enough(Exception):
    """The user wants the map as it is now."""


class BackEnd:
    """Reads words, maps, and answers."""

    def __init__(self, line: Connection, job: Job) -> None:
        self._line, self._job = line, job
        self._mapper = Mapper(job.config, job.folder)
        self._unpacker = Unpacker()
        self._inbox: deque[Any] = deque()
        self._told_s = 0.0
        self._first_s: float | None = None  # when there was something to draw
        self._copy_due_s = 0.0
        self._copied_keyframes = 0
        self._notes: list[str] = []
        self._told_number = -1
        self._gone = False

    def run(self) -> None:
        while True:
            self._receive(0.0 if self._inbox else 0.1)
            if self._gone:
                return
            if self._inbox:
                word = self._inbox.popleft()
                if isinstance(word, Finish):
                    self._finish(word)
                    return
                self._handle(word)
            self._look_after_copies()
            if time.monotonic() - self._told_s > TELL_EVERY_S:
                self._tell()

    def _receive(self, timeout_s: float) -> None:
        try:
            for _ in range(MOST_AT_ONCE):
                if not self._line.poll(timeout_s):
                    return
                self._inbox.append(pickle.loads(self._line.recv_bytes()))
                timeout_s = 0.0
        except (EOFError, OSError):
            self._gone = True

    def _handle(self, word: Any) -> None:
        if isinstance(word, tuple):
            number, items = word
            for item in items:
                message = self._unpacker.unpack(item)
                if message is not None:
                    self._mapper.feed(number, message)
        elif isinstance(word, Thin):
            self._mapper.slam.thin_keyframes(word.spacing)
        elif isinstance(word, Wish):
            self._grant(word)

    def _grant(self, wish: Wish) -> None:
        if not self._mapper.slam.steps:
            self._say(Granted(wish.number, error="no scan came yet: there is nothing to show"))
        elif wish.what == "graph":
            self._say(self._mapper.graph(wish))
        else:
            self._mapper.start_copy(wish)

    def _look_after_copies(self) -> None:
        for found, wish, took_s in self._mapper.harvest():
            self._copy_due_s = time.monotonic() + self._rest_s(took_s)
            error = "the process that draws the map has died" if found is None else found.error
            if wish is not None:
                self._say(Granted(wish.number, None if found is None else found.grid, error=error))
            elif error is not None and error not in self._notes:
                self._notes.append(f"the map on the way was not drawn: {error}")
            if found is not None and found.grid is not None:
                self._say(NewMap(found.grid))
            self._tell()
        count = len(self._mapper.slam.keyframes)
        is_due = count > self._copied_keyframes and time.monotonic() > self._copy_due_s
        if is_due and not self._mapper.copies:
            self._copied_keyframes = count
            self._first_s = self._first_s or time.monotonic()
            self._mapper.start_copy()

    def _rest_s(self, took_s: float) -> float:
        """Until the next copy, after one that took so long."""
        young_s = YOUNG * (time.monotonic() - (self._first_s or time.monotonic()))
        return max(min(self._job.map_every_s, young_s), REST * took_s)

    def _tell(self) -> None:
        self._told_s = time.monotonic()
        corrected = self._mapper.corrected(self._notes)
        if corrected is not None:
            self._say(corrected)

    def _finish(self, word: Finish) -> None:
        def tell(stage: str) -> None:
            self._say(Told(stage))
            self._receive(0.0)
            if any(isinstance(w, Enough) for w in self._inbox):
                self._inbox.clear()
                raise _Enough

        try:
            self._say(self._mapper.finish(word, tell, _Enough))
        except MfslamError as error:
            self._say(Finished(error=str(error)))

    def _say(self, word: Corrected | Granted | NewMap | Told | Finished) -> None:
        with suppress(OSError):  # who has gone is noticed where we read
            self._line.send(word)


def main(fd: int) -> int:
    import signal

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the engine's to answer
    os.set_inheritable(fd, False)
    line = Connection(fd)
    job = pickle.loads(line.recv_bytes())
    compile_once(lambda _: None)
    BackEnd(line, job).run()
    return 0
