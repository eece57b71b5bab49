"""What a live run shows while it goes on: to browsers, and in the terminal."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from mfslam.commands.status_line import StatusLine, describe
from mfslam.live.engine import LiveSlam
from mfslam.live.state import LiveState
from mfslam.viewer.client import Asked, Viewer
from mfslam.viewer.place import Place

SHOW_EVERY_S = 0.1


@dataclass
class Watching:
    """Brings states to a viewer and wishes to save back to the engine; `look` is to be called often, and is quick.

    ``folder``: where a wish to save is written.
    """

    slam: LiveSlam
    status: StatusLine
    folder: Path
    viewer: Viewer | None = None
    _shown_s: float = 0.0
    _begun_s: float = field(default_factory=time.monotonic)
    _asked: dict[int, Asked] = field(default_factory=dict)  # wishes of browsers, by the engine's number
    _told: set[str] = field(default_factory=set)

    def look(self, health: list[dict[str, Any]], more_notes: Callable[[], list[str]] = list) -> None:
        """Show what is new, if it is time. ``health``: of the sensors."""
        now_s = time.monotonic()
        if now_s - self._shown_s < SHOW_EVERY_S:
            return
        self._shown_s = now_s
        notes = more_notes()
        if self.viewer is not None:
            notes += [self.viewer.trouble] if self.viewer.trouble else []
            self._look_after_wishes(self.viewer)
            state = self.slam.state(health)
            self.viewer.show(replace(state, notes=[*state.notes, *notes]))
        for note in notes:
            if note not in self._told:
                self._told.add(note)
                self.status.tell(f"note: {note}")
        self.status.show(lambda: self._figures(health))

    def solving(self) -> None:
        """Nothing moves any more, though it is not the end."""
        if self.viewer is not None:
            self.viewer.end("the drive is over: solving the whole map", last=False)

    def show_last(self, state: LiveState) -> None:
        if self.viewer is not None:
            self.viewer.show(state)
            self.viewer.end(f"ended, saved in {self.folder}/")

    def _look_after_wishes(self, viewer: Viewer) -> None:
        wish = viewer.wish()
        if wish is not None:
            self._asked[self.slam.ask_to_save(self.folder)] = wish
        for number, asked in list(self._asked.items()):
            granted = self.slam.saved(number)
            if granted is not None:
                viewer.answer(asked, f"the map as it is now was written to {self.folder}/", granted.error)
                del self._asked[number]

    def _figures(self, health: list[dict[str, Any]]) -> str:
        state = self.slam.counts(0)
        latency_ms = self.slam.latency.as_ms().get("p99")
        late = "" if latency_ms is None else f", pose within {latency_ms:.0f} ms"
        told = f"{time.monotonic() - self._begun_s:6.0f} s, {state['scans']} scans, {state['keyframes']} keyframes{late}"
        return "; ".join([told, *map(describe, health)])


def open_viewer(
    place: Place | None, folder: Path, tell: Callable[[str], None], stack: ExitStack
) -> Viewer | None:
    """The viewer, where one is wanted; says where it is. Raises MfslamError."""
    if place is None:
        return None
    viewer = stack.enter_context(Viewer(place, folder.resolve().name, folder))
    tell(f"open {viewer.url} in a browser")
    return viewer
