"""What is believed of a run between its refinements."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from mfslam import se2
from mfslam.graph import PoseGraph
from mfslam.slam import Slam
from mfslam.types import FloatArray, IntArray, OccupancyGrid


@dataclass(frozen=True, eq=False)
class Refined:
    """What a copy of the engine found: keyframes (K, 3), all scans until then (S, 3) at their stamps, covariance (3, 3)
    of the last keyframe, the map. ``peak_mb``: that the copy held."""

    keyframes: FloatArray
    scans: FloatArray
    covariance: FloatArray
    grid: OccupancyGrid | None
    error: str | None = None
    peak_mb: float = 0.0


class Belief:
    """Keyframes as the latest refinement has them, those that came since tied on by their own edges.

    Each edge that the refinement knew measures from then on what it found. So refined keyframes stand where it left
    them, and where a new loop contradicts them they give way as the graph would.
    What a loop had closed that it believed, and that has been found wrong since, measures what was measured again.
    """

    def __init__(self) -> None:
        self._refined: Refined | None = None
        self._known: IntArray = np.zeros(0, np.int64)  # numbers of the edges that the refinement knew
        self._poses = np.zeros((0, 3))
        self._loops: IntArray = np.zeros(0, np.int64)  # that these poses take in, by number

    def take(self, refined: Refined, known: IntArray) -> None:
        """A newer refinement, of a graph in which the edges numbered ``known`` were in use."""
        self._refined, self._known, self._poses = refined, known, refined.keyframes
        self._loops = np.zeros(0, np.int64)

    def keyframes(self, graph: PoseGraph) -> FloatArray:
        """(K, 3) world_T_body of all keyframes of ``graph``, which has grown since."""
        if self._refined is None:
            return graph.seen_poses()
        self._known = graph.still_known(self._known, self._refined.keyframes)
        poses, count = graph.seen_poses(), len(self._poses)
        onto = se2.compose(self._poses[-1], se2.inverse(poses[count - 1]))
        self._poses = np.concatenate([self._poses, se2.compose(onto, poses[count:])])
        others = np.setdiff1d(graph.numbers_in_use(), self._known, assume_unique=True)
        loops = graph.loops_among(others)
        if not np.array_equal(loops, self._loops):
            self._loops = loops
            with suppress(FloatingPointError):  # then they are as good as the way that led to them
                self._poses = graph.solved_with(self._known, self._refined.keyframes, self._poses)
        return self._poses

    def trajectory(self, slam: Slam) -> FloatArray:
        """(S, 3) world_T_body of every scan at its stamp."""
        keyframes = self.keyframes(slam.graph)
        poses = slam.trajectory(keyframes)
        if self._refined is not None:
            refined, numbers = self._refined, np.array([k.scan_index for k in slam.keyframes])
            scans = np.arange(numbers[len(refined.keyframes) - 1] + 1)
            nearest = np.searchsorted(numbers, scans, side="right") - 1
            moved = se2.compose(keyframes[nearest], se2.inverse(refined.keyframes[nearest]))
            poses[scans] = se2.compose(moved, refined.scans[scans])
        return poses
