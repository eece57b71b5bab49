"""What loop closure hands from step to step: candidates, fits, loops; and its count of what was refused."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from mfslam.kernels import poses
from mfslam.types import Edge, FloatArray, Match


@dataclass(frozen=True, slots=True)
class Candidate:
    """An old keyframe worth a search, and how far to look about the predicted pose."""

    keyframe: int
    window_m: float
    window_rad: float


@dataclass(frozen=True, eq=False, slots=True)
class Loop:
    """A verified match of the place around keyframe ``j`` with the older one around ``i``."""

    i: int
    j: int
    match: Match
    window_m: float
    score: float

    def edge(self) -> Edge:
        return Edge("loop", self.i, self.j, self.match.ref_T_src, self.match.information)


@dataclass(frozen=True, eq=False, slots=True)
class Fit:
    """One way in which the query may stand in a place; ``refused``: why it is not to be believed."""

    match: Match
    score: float
    refused: str | None


@dataclass
class LoopStatistics:
    searches: int = 0
    places_tried: int = 0
    accepted: int = 0
    taken_out: int = 0  # while mapping, when later loops stood against them
    brought_back: int = 0
    refused: dict[str, int] = field(default_factory=dict)

    def refuse(self, reason: str) -> None:
        self.refused[reason] = self.refused.get(reason, 0) + 1


def apart(a: FloatArray, b: FloatArray, limit_m: float = 0.3) -> bool:
    """Whether two poses (3,) are two hypotheses."""
    off = poses.between(a, b)
    return math.hypot(off[0], off[1]) > limit_m or abs(off[2]) > 0.1
