"""The mapping half of a live run: the engine of `mfslam.slam`, what it believes between its solves, and copies of it
that refine and draw."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from drivers.base import LogInfo
from mfslam import se2
from mfslam.config import Config
from mfslam.live.belief import Belief, Refined
from mfslam.live.memory import forget_peak, peak_mb
from mfslam.live.words import Corrected, Finish, Finished, Granted, Memory, Wish
from mfslam.mapping import render_map
from mfslam.outcome import leave, outcome_of
from mfslam.output.growing_map import write_growing_map
from mfslam.slam import Slam, Solution
from mfslam.types import Edge, Findings, FloatArray, IntArray, Message, MfslamError, OccupancyGrid, Scan

STANDING_M, STANDING_RAD, ENOUGH_SCANS = 0.01, 0.005, 20  # scans from one spot that the map needs
NICE = 10  # of the copies


@dataclass(frozen=True, eq=False)
class _Copy:
    """A copy at work: the line from it, its process, keyframes and edges in use when it began, whose wish it is."""

    line: Connection
    pid: int
    keyframes: int
    edges: IntArray
    wish: Wish | None
    started_s: float


class Mapper:
    """Takes messages and says where the newest scan is, as far as graph and refinements know."""

    def __init__(self, config: Config, folder: Path | None) -> None:
        self.config, self.folder = config, folder
        self.slam = Slam(config)
        self._numbers: list[int] = []  # of the scans that were fed
        self._belief = Belief()
        self._covariance = np.zeros((3, 3))  # of the newest keyframe, in its tangent
        self._edges_seen = 0
        self._kept_at: FloatArray | None = None
        self._kept = 0
        self._copies: list[_Copy] = []
        self._blank: dict[int, Any] = {}
        self._start_mb = self._copies_mb = 0.0

    # --- messages -----------------------------------------------------------------------------------

    def feed(self, number: int, message: Message) -> None:
        """The next message; ``number`` of a scan, -1 of anything else."""
        keyframes = len(self.slam.keyframes)
        if isinstance(message, Scan):
            if not self._numbers:
                forget_peak()
                self._start_mb = peak_mb()
            self._numbers.append(number)
        self.slam.feed(message)
        if isinstance(message, Scan) and len(self.slam.steps):
            self._drop_ranges_where_standing(len(self.slam.keyframes) > keyframes)
        self._carry_covariance()

    def _drop_ranges_where_standing(self, is_keyframe: bool) -> None:
        """A robot that stands sees the same again and again: what is kept grows with the way, not with time."""
        slam, n = self.slam, len(self.slam.steps) - 1
        at = slam.steps[n].local_T_body
        moved = np.full(3, np.inf) if self._kept_at is None else np.abs(se2.between(self._kept_at, at))
        if float(np.hypot(moved[0], moved[1])) > STANDING_M or moved[2] > STANDING_RAD:
            self._kept_at, self._kept = at, 0
        self._kept += 1
        if self._kept > ENOUGH_SCANS and not is_keyframe:
            scan = slam.scans[n]
            nothing = np.full_like(scan.ranges_m, np.nan)
            slam.scans[n] = replace(scan, ranges_m=self._blank.setdefault(len(nothing), nothing))

    def _carry_covariance(self) -> None:
        """From keyframe to keyframe, by what ties each to the one before."""
        edges = self.slam.graph.edges
        self._covariance = carried(self._covariance, edges[self._edges_seen :])
        self._edges_seen = len(edges)

    # --- what is believed ---------------------------------------------------------------------------

    def keyframes(self) -> FloatArray:
        """(K, 3) world_T_body: as refined, those that came since tied on."""
        return self._belief.keyframes(self.slam.graph)

    def trajectory(self) -> FloatArray:
        """(S, 3) world_T_body of every scan at its stamp, as far as it is known now."""
        return self._belief.trajectory(self.slam)

    def corrected(self, notes: list[str]) -> Corrected | None:
        """Where the newest placed scan is; None before the first."""
        placed = len(self.slam.steps)
        if not placed:
            return None
        keyframes, last = self.keyframes(), self.slam.keyframes[-1]
        moved = se2.between(last.local_T_body, self.slam.steps[-1].local_T_body)
        world_T_body = se2.compose(keyframes[-1], moved)
        loops = [(e.i, e.j) for e in self.slam.graph.live_edges() if e.kind == "loop"]
        return Corrected(
            self._numbers[placed - 1], world_T_body, in_world(self._covariance, keyframes[-1]), keyframes,
            np.array(loops, dtype=np.int64).reshape(-1, 2), [*notes, *self.slam.findings.lines()],
        )  # fmt: skip

    # --- copies that refine and draw ------------------------------------------------------------------

    @property
    def copies(self) -> int:
        return len(self._copies)

    def start_copy(self, wish: Wish | None = None) -> None:
        """A copy of this process solves and draws what is known now; `harvest` has what came of it.

        The process has one thread, so that a fork is whole; its memory is shared until either side writes.
        """
        if not self.slam.steps:
            return
        ours, theirs = Pipe(duplex=False)
        sys.stdout.flush()
        child = os.fork()
        if child == 0:
            status = 1
            try:
                ours.close()
                os.nice(NICE)
                forget_peak()
                theirs.send(self._as_copy(wish))
                status = 0
            finally:
                os._exit(status)
        theirs.close()
        edges = self.slam.graph.numbers_in_use()
        self._copies.append(_Copy(ours, child, len(self.slam.keyframes), edges, wish, time.monotonic()))

    def harvest(self) -> list[tuple[Refined | None, Wish | None, float]]:
        """Copies that have ended: what they found (None of one that died), whose wish it was, how long it took."""
        out = []
        for copy in list(self._copies):
            if not copy.line.poll(0):
                continue
            try:
                found: Refined | None = copy.line.recv()
            except (EOFError, OSError):
                found = None
            copy.line.close()
            os.waitpid(copy.pid, 0)
            self._copies.remove(copy)
            if found is not None and found.error is None:
                # the copy has placed the scan that was waiting, too
                self._copies_mb = max(self._copies_mb, found.peak_mb)
                self._take(replace(found, keyframes=found.keyframes[: copy.keyframes]), copy.edges)
            out.append((found, copy.wish, time.monotonic() - copy.started_s))
        return out

    def _take(self, found: Refined, edges: IntArray) -> None:
        self._belief.take(found, edges)
        later = [edge for edge in self.slam.graph.edges[: self._edges_seen] if edge.j >= len(found.keyframes)]
        self._covariance = carried(found.covariance, later)

    def _as_copy(self, wish: Wish | None) -> Refined:
        nothing = np.zeros((0, 3))
        try:
            slam = self.slam
            solution = slam.finish()
            keyframes = slam.graph.poses()
            pose = solution.world_T_body[solution.keyframes[-1]]
            covariance = in_tangent(solution.covariances[solution.keyframes[-1]], pose)
            if wish is not None and wish.what == "save" and wish.folder is not None:
                outcome = self._outcome(solution, Finish(wish.folder, wish.folder, "live"))
                leave(outcome, self.config, wish.folder, None)
                grid = outcome.result.grid
            else:
                grid = self._draw(solution)
            return Refined(keyframes, solution.world_T_body, covariance, grid, peak_mb=peak_mb())
        except MfslamError as error:
            return Refined(nothing, nothing, np.zeros((3, 3)), None, str(error))

    def _draw(self, solution: Solution) -> OccupancyGrid:
        grid, _ = render_map(
            self.slam.scans, solution.world_T_reference, solution.twists, self.config, Findings()
        )
        if self.folder is not None:
            write_growing_map(self.folder, grid)
        return grid

    # --- the end ------------------------------------------------------------------------------------

    def graph(self, wish: Wish) -> Granted:
        return Granted(wish.number, graph=(self.keyframes(), self.slam.graph.live_edges()))

    def finish(self, word: Finish, tell: Callable[[str], None], enough: type[Exception]) -> Finished:
        """The final solve and the folder. ``tell`` may raise ``enough``: then it is written as it stands."""
        for copy in self._copies:
            os.kill(copy.pid, 9)
            os.waitpid(copy.pid, 0)
        slam, interrupted, mapped_mb = self.slam, False, peak_mb()
        slam.place_last()
        if not slam.scans:
            return Finished(error="no scan came: nothing to map")
        online = self.trajectory()
        try:
            solution = slam.finish(tell)
        except enough:
            interrupted = True
            slam.findings.add(
                "not-refined", "interrupted while refining: the map is as good as it was by then"
            )
            solution = slam.solution_so_far()
        tell("drawing the map")
        outcome = self._outcome(solution, word, interrupted)
        if word.folder is not None:
            leave(outcome, self.config, word.folder, None)
        return Finished(
            outcome.summary,
            outcome.result.findings.lines(),
            solution.stamps_ns,
            online,
            solution.world_T_body,
            outcome.result.grid,
            Memory(self._start_mb, mapped_mb, peak_mb(), self._copies_mb),
        )

    def _outcome(self, solution: Solution, word: Finish, interrupted: bool = False) -> Any:
        findings = Findings()
        for code, text, where, count in word.findings:
            findings.add(code, text, where, count)
        info = LogInfo(word.source, word.format)
        return outcome_of(self.slam, solution, self.config, info, findings, interrupted, 0.0)


def carried(covariance: FloatArray, edges: Sequence[Edge]) -> FloatArray:
    """A covariance (3, 3) in the tangent of a keyframe, carried over the steps to the next ones that ``edges`` hold."""
    steps: dict[int, FloatArray] = {}
    motions: dict[int, FloatArray] = {}
    for edge in edges:
        if edge.j == edge.i + 1 and edge.kind != "heading":
            steps[edge.j] = steps.get(edge.j, 0.0) + edge.information
            motions.setdefault(edge.j, edge.i_T_j)
    for j, information in sorted(steps.items()):
        back = se2.adjoint(se2.inverse(motions[j]))
        covariance = back @ covariance @ back.T + np.linalg.inv(information)
    return covariance


def in_world(covariance: FloatArray, pose: FloatArray) -> FloatArray:
    """A covariance (3, 3) in the tangent of ``pose`` (3,), in the world's axes."""
    turn = np.eye(3)
    c, s = np.cos(pose[2]), np.sin(pose[2])
    turn[:2, :2] = [[c, -s], [s, c]]
    return np.asarray(turn @ covariance @ turn.T)


def in_tangent(covariance: FloatArray, pose: FloatArray) -> FloatArray:
    """The inverse of `in_world`."""
    return in_world(covariance, np.array([0.0, 0.0, -pose[2]]))
