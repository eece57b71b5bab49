"""The back end's process, as the engine holds it: whatever goes to it waits in the journal; when it dies, another one
takes all of it again."""

from __future__ import annotations

import pickle
import threading
from collections.abc import Callable
from typing import Any

from drivers.own_process import OwnProcess
from mfslam.live.journal import Journal
from mfslam.live.words import Job
from mfslam.types import MfslamError

LOOK_UP_S = 0.2
MOST_RESTARTS = 5
LEAVE_S = 3.0


class Link:
    """Runs the process, sends the journal to it, and hands what it says to ``hear`` (in a thread of its own).

    ``trouble``: what happened to the process, in words; ``dead``: it is not started again.
    """

    def __init__(self, job: Job, hear: Callable[[Any], None]) -> None:
        self._job, self._hear = job, hear
        self.journal = Journal(job.folder)
        self.restarts = 0
        self.trouble: str | None = None
        self.dead = False
        self._closing = False
        self._urgent: list[Any] = []
        self._start()
        self._sender = threading.Thread(target=self._send, daemon=True, name="to the back end")
        self._sender.start()

    @property
    def pid(self) -> int:
        return self.process.pid

    def say_now(self, word: Any) -> None:
        """Something that is not worth keeping for a new process."""
        self._urgent.append(word)
        self.journal.wake()

    def close(self) -> None:
        self._closing = True
        self.journal.wake()
        self._sender.join(LEAVE_S)
        self.process.end(LEAVE_S)
        self.journal.close()

    # --- inside ---------------------------------------------------------------------------------------

    def _start(self) -> None:
        self.process = OwnProcess("mfslam.live", {"OPENBLAS_NUM_THREADS": "1"})
        self._sent = 0
        self.process.line.send_bytes(pickle.dumps(self._job))
        self.process.listen(self._hear, gone=self.journal.wake)

    def _send(self) -> None:
        while not self._closing:
            try:
                if self.process.has_ended:
                    raise BrokenPipeError
                while self._urgent:
                    self.process.line.send_bytes(pickle.dumps(self._urgent.pop(0)))
                if self.journal.wait_beyond(self._sent, LOOK_UP_S) and not self._closing:
                    data, following = self.journal.read(self._sent)
                    self.process.line.send_bytes(data)
                    self._sent = following
            except OSError:
                if self._closing or not self._revive():
                    return

    def _revive(self) -> bool:
        self.process.end(LEAVE_S)
        how = self.process.how_it_ended()
        if self.restarts >= MOST_RESTARTS:
            self.trouble = (
                f"the process that maps {how} for the {self.restarts + 1}th time: it is not started again"
            )
            self.dead = True
            return False
        self.restarts += 1
        self.trouble = f"the process that maps {how}: a new one reads everything again from the journal"
        try:
            self._start()
        except OSError as error:
            raise MfslamError(f"the process that maps cannot be started: {error}") from None
        return True
