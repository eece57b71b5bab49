"""`LiveSlam`: what a program holds that maps while the robot drives."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from threading import Condition
from types import TracebackType
from typing import Any, Self

import numpy as np

from drivers.acquisition.messages import Packer
from mfslam import se2
from mfslam.config import Config
from mfslam.deskew import deskew, reference_offset_s
from mfslam.kernels.warm_up import compile_once
from mfslam.live.latency import Latency
from mfslam.live.link import Link
from mfslam.live.mapper import in_world
from mfslam.live.memory import forget_peak
from mfslam.live.pressure import RELAX_AT_S, Pressure
from mfslam.live.state import LiveState
from mfslam.live.tracking import Tracked, Tracker
from mfslam.live.words import Corrected, Enough, Finish, Finished, Granted, Job, NewMap, Thin, Told, Wish
from mfslam.types import (
    Edge,
    Findings,
    FloatArray,
    Laser,
    Message,
    MfslamError,
    OccupancyGrid,
    Odometry,
    Scan,
)

WISH_S = 120.0
START_S = 60.0  # that a back end may take to start and to read what waits


class LiveSlam:
    """2D laser SLAM while the robot drives: poses at once, graph, loops and map in a process beside it.

    >>> with LiveSlam(Config()) as slam:                      # doctest: +SKIP
    ...     for message in feed:
    ...         world_T_body = slam.feed(message)
    ...     slam.finish(Path("OUT"), Path("robot.mcap"))

    ``folder``: where the map is renewed while it grows, every ``map_every_s`` at most. ``tell``: told where something
    takes its time, such as compiling on the first run. Raises MfslamError in one line.
    """

    def __init__(
        self, config: Config, folder: Path | None = None, map_every_s: float = 15.0,
        tell: Callable[[str], None] = lambda _: None,
    ) -> None:  # fmt: skip
        self.config = config
        self.findings = Findings()
        self.pressure = Pressure(self.findings)
        self.may_thin = True  # where nobody waits for the map, keyframes and scans give way
        self.local_T_body, self.world_T_body = np.zeros(3), np.zeros(3)  # at the newest scan's stamp
        self._local_T_reference = np.zeros(3)  # at the instant that its points are carried to
        self.grid: OccupancyGrid | None = None
        self.latency = Latency()
        self._tracker = Tracker(config)
        self._packer = Packer()
        self._newest: Tracked | None = None
        self._scans = 0
        self._starts, self._started_s, self._came_up = -1, 0.0, False  # of the back end
        # number, when, pose: of scans that the back end has not confirmed yet
        self._sent: deque[tuple[int, float, FloatArray | None]] = deque()
        self._world_T_local = np.zeros(3)
        self._heard = Condition()
        self._corrected: Corrected | None = None
        self._applied: Corrected | None = None
        self._granted: dict[int, Granted] = {}
        self._wishes = 0
        self._finished: Finished | None = None
        self._tell = tell
        compile_once(tell)
        warm_up(config)
        forget_peak()
        self._link = Link(Job(config, folder, map_every_s), self._hear)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """End the back end, whatever it does; a finished folder stays, an unfinished one is never half written."""
        self._link.close()

    # --- feeding ------------------------------------------------------------------------------------

    def feed(self, message: Message, place: bool = True) -> FloatArray | None:
        """Take the next message; of a scan, where the robot is: world_T_body (3,), at once.

        ``place``: without it a scan goes into the map alone, for callers that are too late for its pose.
        """
        if not isinstance(message, Scan):
            self._tracker.note(message)
            self._link.journal.append((-1, self._packer.pack(message)))
            return None
        number, self._scans = self._scans, self._scans + 1
        pose = None
        if place:
            with self.latency:
                pose = self._place(message)
        self._apply_correction()
        behind_s = self.behind_s
        if not self.may_thin or not self._came_up or self.pressure.goes_to_map(number, behind_s):
            self._link.journal.append((number, self._packer.pack(message)))
            self._sent.append((number, time.monotonic(), None if pose is None else self._local_T_reference))
        if self.may_thin:
            self._relieve(behind_s)
        return pose

    def _place(self, scan: Scan) -> FloatArray:
        self._newest = self._tracker.place(self._scans - 1, scan)
        self._local_T_reference = self._newest.step.local_T_body
        to_stamp = se2.exp(-reference_offset_s(scan.laser) * self._newest.twist)
        self.local_T_body = se2.compose(self._local_T_reference, to_stamp)
        self._apply_correction()
        self.world_T_body = se2.compose(self._world_T_local, self.local_T_body)
        return self.world_T_body

    def _apply_correction(self) -> None:
        """world_T_local, from the newest scan that the back end has placed and we had placed too."""
        corrected = self._corrected
        if corrected is None or corrected is self._applied:
            return
        self._applied = corrected
        while self._sent and self._sent[0][0] <= corrected.number:
            number, _, local_T_reference = self._sent.popleft()
            if number == corrected.number and local_T_reference is not None:
                self._world_T_local = se2.compose(corrected.world_T_body, se2.inverse(local_T_reference))
                self.world_T_body = se2.compose(self._world_T_local, self.local_T_body)

    def _relieve(self, behind_s: float) -> None:
        """Keyframes give way where the map falls behind; not while a back end is only starting."""
        if self._starts != self._link.restarts:
            self._starts, self._started_s, self._came_up = self._link.restarts, time.monotonic(), False
        self._came_up |= behind_s < RELAX_AT_S or time.monotonic() - self._started_s > START_S
        if not self._came_up:
            return
        if self.pressure.watch(behind_s, time.monotonic()):
            self._tracker.frontend.spacing = self.pressure.spacing
            self._link.journal.append(Thin(self.pressure.spacing))

    @property
    def placed_ns(self) -> int:
        """Stamp of the newest scan that was placed; 0 before the first."""
        return 0 if self._newest is None else self._newest.scan.stamp_ns

    @property
    def back_end_pid(self) -> int:
        return self._link.pid

    @property
    def behind_s(self) -> float:
        """For how long a scan has waited for the back end, the newest not counted: it waits for its wheels."""
        return time.monotonic() - self._sent[0][1] if len(self._sent) > 1 else 0.0

    def wait(self, behind: int, timeout_s: float = 60.0) -> None:
        """Let the back end come up to so many scans, for a caller that could feed faster than it maps."""
        limit_s = time.monotonic() + timeout_s
        while len(self._sent) > behind and time.monotonic() < limit_s and not self._link.dead:
            with self._heard:
                self._heard.wait(0.05)
            self._apply_correction()

    # --- what is known --------------------------------------------------------------------------------

    @property
    def world_T_local(self) -> FloatArray:
        """(3,) what graph and loops correct of the frame that never jumps (ROS: map to odom)."""
        return self._world_T_local

    @property
    def covariance(self) -> FloatArray:
        """(3, 3) of x, y and yaw of `world_T_body`, in the world's axes, relative to the first pose."""
        known = np.zeros((3, 3)) if self._applied is None else self._applied.covariance
        match = None if self._newest is None else self._newest.step.match
        if match is None:
            return known
        own = np.asarray(np.linalg.inv(match.information + np.eye(3)), dtype=np.float64)
        return np.asarray(known + in_world(own, self.world_T_body), dtype=np.float64)

    def state(self, health: Sequence[dict[str, Any]] = ()) -> LiveState:
        """All that there is to see. ``health``: of the sensors, where there are some."""
        self._apply_correction()
        applied, newest = self._applied, self._newest
        points = np.zeros((0, 2))
        stamp_ns = 0
        if newest is not None:
            cloud = deskew(newest.scan, newest.twist, self.config.deskew)
            points = se2.transform(se2.compose(self._world_T_local, self._local_T_reference), cloud.points_m)
            stamp_ns = newest.scan.stamp_ns
        loops = np.zeros((0, 2), np.int64) if applied is None else applied.loops
        return LiveState(
            stamp_ns, self.world_T_body, self.local_T_body, self.covariance, points,
            np.zeros((0, 3)) if applied is None else applied.keyframes, loops, self.grid, list(health),
            self.counts(len(loops)), self.latency.as_ms(), self.notes(),
        )  # fmt: skip

    def counts(self, loops: int) -> dict[str, int]:
        return {
            "scans": self._scans,
            "keyframes": 0 if self._applied is None else len(self._applied.keyframes),
            "loops": loops,
            "scans_waiting": len(self._sent),
            "scans_dropped": self.pressure.not_placed + self.pressure.not_mapped,
            "keyframe_spacing_percent": round(100 * self.pressure.spacing),
            "back_end_restarts": self._link.restarts,
        }

    def notes(self) -> list[str]:
        known = [] if self._applied is None else self._applied.notes
        trouble = [] if self._link.trouble is None else [self._link.trouble]
        return [*known, *self.findings.lines(), *trouble]

    def map(self) -> OccupancyGrid:
        """The map as it is now, refined and drawn for this call. Raises MfslamError."""
        grid = self._have(Wish(self._new_wish(), "map")).grid
        assert grid is not None
        return grid

    def graph(self) -> tuple[FloatArray, list[Edge]]:
        """Keyframes (K, 3) and the edges between them, as they are now. Raises MfslamError."""
        graph = self._have(Wish(self._new_wish(), "graph")).graph
        assert graph is not None
        return graph

    def ask_to_save(self, folder: Path) -> int:
        """Have a run folder written beside the mapping; `saved` tells what came of it."""
        wish = Wish(self._new_wish(), "save", folder)
        self._link.journal.append(wish)
        return wish.number

    def saved(self, number: int) -> Granted | None:
        return self._granted.pop(number, None)

    def _new_wish(self) -> int:
        self._wishes += 1
        return self._wishes

    def _have(self, wish: Wish) -> Granted:
        self._link.journal.append(wish)
        limit_s = time.monotonic() + WISH_S
        with self._heard:
            while wish.number not in self._granted:
                if time.monotonic() > limit_s or self._link.dead:
                    raise MfslamError(f"the {wish.what} did not come within {WISH_S:.0f} s")
                self._heard.wait(0.2)
        granted = self._granted.pop(wish.number)
        if granted.error is not None:
            raise MfslamError(granted.error)
        return granted

    # --- the end ------------------------------------------------------------------------------------

    def finish(
        self,
        folder: Path | None,
        source: Path,
        form: str = "live",
        findings: Findings | None = None,
        tell: Callable[[str], None] = lambda _: None,
        enough: Callable[[], bool] = lambda: False,
    ) -> Finished:
        """The final solve, as offline, and the folder of `mfslam map` where one is wanted.

        ``source``, ``form``: what was mapped, for the report; ``findings``: of whoever fed. ``enough``: asked now and
        then; when true, it is written without further refinement. Raises MfslamError.
        """
        self._tell = tell
        every = Findings()
        for some in (findings, self.findings):
            if some is not None:
                every.merge(some)
        all_told = [(code, f.text, f.first_where, f.count) for code, f in every]
        self._link.journal.append(Finish(folder, source, form, all_told))
        asked = False
        with self._heard:
            while self._finished is None:
                self._heard.wait(0.2)
                if self._link.dead:
                    raise MfslamError(self._link.trouble or "the process that maps has died")
                if not asked and enough():
                    asked = True
                    self._link.say_now(Enough())
        if self._finished.error is not None:
            raise MfslamError(self._finished.error)
        return self._finished

    def _hear(self, word: Any) -> None:
        with self._heard:
            if isinstance(word, Corrected):
                self._corrected = word
            elif isinstance(word, NewMap):
                self.grid = word.grid
            elif isinstance(word, Granted):
                self._granted[word.number] = word
            elif isinstance(word, Finished):
                self._finished = word
                self.grid = word.grid or self.grid
            elif isinstance(word, Told):
                self._tell(word.text)
            self._heard.notify_all()


def warm_up(config: Config) -> None:
    """What the first scan would have to wait for: kernels are loaded by a few scans of a made-up room."""
    angles = np.linspace(-2.0, 2.0, 400)
    laser = Laser("warm-up", angles, np.linspace(0.0, 0.05, 400), 0.05, 30.0, 0.02, np.zeros(3))
    corners = np.maximum(np.abs(np.cos(angles)), np.abs(np.sin(angles)))
    tracker = Tracker(config)
    for n in range(4):
        tracker.note(Odometry(n * 100_000_000, np.array([0.2 * n, 0.0, 0.0])))
        ranges_m = ((3.0 - 0.2 * n) / corners).astype(np.float32)
        tracker.place(n, Scan(n * 100_000_000, ranges_m, laser))
