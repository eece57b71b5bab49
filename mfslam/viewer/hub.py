"""Where the newest snapshot lies, and where browsers wait for it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

from mfslam.viewer.snapshot import Snapshot

Answer = dict[str, Any]
SAVE_PATIENCE_S = 120.0


class Hub:
    """One writer, any number of browsers: each takes the newest when it is ready for it; what came in between is
    never queued. ``ask`` sends a wish to whoever owns the map, ``answered`` brings the reply."""

    def __init__(self, ask: Callable[[int], None] | None = None) -> None:
        self._ask = ask
        self._changed = threading.Condition()
        self._number = 0
        self._snapshot = Snapshot()
        self._answers: dict[int, Answer] = {}
        self._asked = 0
        self.over: str | None = None
        self.last = False
        self.closing = False  # browsers are told what there is and let go

    @property
    def can_save(self) -> bool:
        return self._ask is not None

    @property
    def snapshot(self) -> Snapshot:
        return self._snapshot

    def show(self, snapshot: Snapshot) -> None:
        with self._changed:
            self._snapshot = snapshot
            self._number += 1
            self._changed.notify_all()

    def end(self, why: str, last: bool = True) -> None:
        """Nothing new will come, or not soon; ``why`` in words, and whether these are the last."""
        with self._changed:
            self.over, self.last = why, last
            self._number += 1
            self._changed.notify_all()

    def close(self) -> None:
        with self._changed:
            self.closing = True
            self._number += 1
            self._changed.notify_all()

    def newest(self, after: int, timeout_s: float) -> tuple[int, Snapshot]:
        """The newest snapshot and its number, at once if that is not ``after``, else when it comes or time is up."""
        with self._changed:
            self._changed.wait_for(lambda: self._number != after, timeout_s)
            return self._number, self._snapshot

    def save(self) -> Answer:
        """Have the map written; what came of it, in ``text`` or ``error``."""
        if self._ask is None:
            return {"error": "there is nothing to save here"}
        with self._changed:
            self._asked += 1
            number = self._asked
            self._ask(number)
            end_s = time.monotonic() + SAVE_PATIENCE_S
            while number not in self._answers and self.over is None:
                if not self._changed.wait(end_s - time.monotonic()):
                    return {"error": f"no answer in {SAVE_PATIENCE_S:.0f} s"}
            return self._answers.pop(number, {"error": self.over})

    def answered(self, number: int, answer: Answer) -> None:
        with self._changed:
            self._answers[number] = answer
            self._changed.notify_all()
