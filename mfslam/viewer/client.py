"""The end of the viewer that the engine holds: it is never kept waiting by it."""

from __future__ import annotations

import secrets
import threading
import time
from collections import deque
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from drivers.own_process import OwnProcess
from mfslam.live.state import LiveState
from mfslam.types import MfslamError, OccupancyGrid
from mfslam.viewer.place import Job, Place, address

START_S = 60.0
PAUSE_S = 1.0  # before a viewer that has died is started again
MOST_RESTARTS = 20
LEAVE_S = 3.0
Asked = tuple[int, int]  # which of the viewer's processes asks, and its number there


class Viewer:
    """The viewer's process, and a thread that feeds it with the newest state. A context manager.

    Only people who know the address are let in: where other machines can reach it, it holds a token. A viewer
    that dies is started again at the same address; browsers find it by themselves. Raises MfslamError for an
    address that cannot be had.
    """

    def __init__(self, place: Place, title: str, folder: Path) -> None:
        token = "" if place.local else secrets.token_urlsafe(12)
        self._job = Job(place, token, {"mode": "live", "title": title, "save": True}, folder)
        self._wake = threading.Condition()
        self._state: LiveState | None = None
        self._words: deque[tuple[Any, ...]] = deque()
        self._over: tuple[Any, ...] | None = None  # the latest word that nothing new comes
        self._wishes: deque[Asked] = deque()
        self._closing = False
        self.restarts = 0
        self.trouble: str | None = None
        self._start()
        self.url = address(self._job.place, token)
        self._thread = threading.Thread(target=self._feed, daemon=True, name="viewer")
        self._thread.start()

    # --- for the engine -------------------------------------------------------------------------------

    def show(self, state: LiveState) -> None:
        """Have this shown, unless a newer one comes first. Returns at once."""
        with self._wake:
            self._state = state
            self._wake.notify()

    def wish(self) -> Asked | None:
        """A wish to save the map now, if a browser has one; it is to be `answer`-ed."""
        return self._wishes.popleft() if self._wishes else None

    def answer(self, wish: Asked, text: str | None = None, error: str | None = None) -> None:
        """What came of a wish, in words."""
        process, number = wish
        with self._wake:
            if process != self.restarts:  # who asked has gone
                return
            self._words.append(("answer", number, {"error": error} if error is not None else {"text": text}))
            self._wake.notify()

    def end(self, why: str, last: bool = True) -> None:
        """Nothing new will come, or not soon: ``why``, in words, stands on the page, if it is the ``last`` word also when
        we have gone."""
        with self._wake:
            self._over = ("over", why, last)
            self._words.append(self._over)
            self._wake.notify()

    def close(self) -> None:
        with self._wake:
            self._closing = True
            self._wake.notify()
        self._thread.join(LEAVE_S)
        self.process.end(LEAVE_S)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if isinstance(error, MfslamError):
            self.end(f"ended: {error}")
        self.close()

    # --- its process ----------------------------------------------------------------------------------

    def _start(self) -> None:
        process = self.process = OwnProcess("mfslam.viewer")
        process.line.send(self._job)
        try:
            word, value = process.line.recv() if process.line.poll(START_S) else ("failed", "no word in time")
        except (EOFError, OSError):
            word, value = "failed", f"the viewer's process {process.how_it_ended()}"
        if word != "ready" or not isinstance(value, int):
            process.end()
            raise MfslamError(str(value))
        self._job = replace(self._job, place=replace(self._job.place, port=value))
        asks = self.restarts
        process.listen(lambda wish: self._wishes.append((asks, wish[1])), gone=self._notify)

    def _notify(self) -> None:
        with self._wake:
            self._wake.notify()

    def _feed(self) -> None:
        grid: OccupancyGrid | None = None  # what the process has
        last: LiveState | None = None
        while True:
            with self._wake:
                self._wake.wait_for(self._something_to_do, 1.0)
                closing, state, self._state = self._closing, self._state, None
                words, self._words = self._words, deque()
            try:
                if state is not None:
                    last = state
                    self.process.line.send(
                        ("state", replace(state, grid=None) if state.grid is grid else state)
                    )
                    grid = state.grid
                for word in words:
                    self.process.line.send(word)
                if self.process.has_ended:
                    raise BrokenPipeError
            except OSError:
                if closing or not self._revive():
                    return
                grid = None
                with self._wake:
                    self._state = self._state or last
                    self._words = deque() if self._over is None else deque([self._over])
            if closing:
                return

    def _something_to_do(self) -> bool:
        return self._state is not None or bool(self._words) or self._closing or self.process.has_ended

    def _revive(self) -> bool:
        """Start the process again; False when that is over."""
        how = self.process.how_it_ended()
        while not self._closing and self.restarts < MOST_RESTARTS:
            self.restarts += 1
            self.trouble = f"the viewer's process {how}: it is started again"
            time.sleep(PAUSE_S)
            self.process.end()
            try:
                self._start()
            except MfslamError as error:
                how = f"does not start: {error}"
                continue
            self.trouble = f"the viewer's process {how} and was started again; mapping went on meanwhile"
            return True
        self.trouble = f"the viewer's process {how}: it is not started again; mapping goes on without it"
        return False
