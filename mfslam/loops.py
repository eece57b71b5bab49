"""Loop closure: candidates by the graph's uncertainty, a search as wide as it, verification, and several
that agree before any from a wide search is believed."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from mfslam import icp
from mfslam.config import Config
from mfslam.frontend import Keyframe
from mfslam.kernels import poses, reach
from mfslam.places import Place, PlaceMemory
from mfslam.search import search
from mfslam.types import Edge, FloatArray, Match

CHI2_3DOF = {0.99: 11.34, 0.999: 16.27}


@dataclass(frozen=True, eq=False, slots=True)
class Loop:
    """A verified match of the place around keyframe ``j`` with the older one around ``i``."""

    i: int
    j: int
    match: Match
    window_m: float

    def edge(self) -> Edge:
        return Edge("loop", self.i, self.j, self.match.ref_T_src, self.match.information)


@dataclass
class LoopStatistics:
    searches: int = 0
    places_tried: int = 0
    accepted: int = 0
    refused: dict[str, int] = field(default_factory=dict)

    def refuse(self, reason: str) -> None:
        self.refused[reason] = self.refused.get(reason, 0) + 1


class LoopCloser:
    """Watches the keyframes go by and proposes loop edges."""

    def __init__(self, config: Config, keyframes: list[Keyframe]) -> None:
        self.config = config.loops
        self.icp_config = config.icp
        self.gate = config.graph.gate_probability
        self.keyframes = keyframes
        self.travel_m: list[float] = []
        self.statistics = LoopStatistics()
        self._memory = PlaceMemory(keyframes)
        self._last_search_m = 0.0
        self._waiting: list[Loop] = []

    def add_keyframe(self) -> None:
        """Note the newest keyframe; call once for each."""
        if not self.travel_m:
            self.travel_m.append(0.0)
            return
        a, b = self.keyframes[-2].local_T_body, self.keyframes[-1].local_T_body
        self.travel_m.append(self.travel_m[-1] + math.hypot(b[0] - a[0], b[1] - a[1]))

    def due(self) -> bool:
        return self.config.use and self.travel_m[-1] - self._last_search_m >= self.config.every_m

    def search(
        self,
        world_T_body: FloatArray,
        edges: list[Edge],
        relative_covariance: Callable[[int, int], FloatArray],
        sigma_m: float,
    ) -> list[Loop]:
        """Loops of the newest keyframe that are to be believed. ``world_T_body`` (K, 3): the estimate."""
        self.statistics.searches += 1
        self._last_search_m = self.travel_m[-1]
        j = len(self.keyframes) - 1
        candidates = self._candidates(j, world_T_body, edges)
        if not candidates:
            return []
        members = self._members(j, trailing=True)
        query = Place.of(self.keyframes, members, j)
        believed: list[Loop] = []
        for i, window_m, window_rad in candidates:
            self.statistics.places_tried += 1
            place, search_map = self._memory.at(self._members(i, trailing=False), i)
            guess = poses.between(world_T_body[place.anchor], world_T_body[j])
            loop = self._verify(place, search_map, query, guess, window_m, window_rad, sigma_m)
            if loop is None:
                continue
            if self._passes_gate(loop, world_T_body, relative_covariance):
                believed += self._with_partners(loop)
        self.statistics.accepted += len(believed)
        return believed

    # --- candidates ---------------------------------------------------------------------------------

    def _candidates(
        self, j: int, world_T_body: FloatArray, edges: list[Edge]
    ) -> list[tuple[int, float, float]]:
        """(keyframe, half window in m, in rad) of old places within reach, the surest first."""
        config = self.config
        travel = np.array(self.travel_m)
        old = travel < travel[j] - config.min_travel_m
        if not old.any():
            return []
        variances = reach.relative_sigmas(j, world_T_body, *adjacency(len(travel), edges))
        sigma = np.sqrt(variances[:, 0])
        distance = np.hypot(*(world_T_body[:, :2] - world_T_body[j, :2]).T)
        near = old & (distance < config.reach_m * 0.5 + config.window_sigmas * sigma) & (
            config.window_sigmas * sigma < 2.0 * config.max_window_m
        )
        # one place per half segment of path, its nearest keyframe; passes by the same spot count apart
        half = config.segment_m / 2.0
        best: dict[int, int] = {}
        for k in np.flatnonzero(near):
            stretch = int(travel[k] / half)
            if stretch not in best or distance[k] < distance[best[stretch]]:
                best[stretch] = int(k)
        # an anchor per stretch that does not depend on the query, so that places can be kept
        chosen = sorted(best.values(), key=lambda k: float(distance[k] + sigma[k]))[: config.max_places]
        out = []
        for k in chosen:
            window_m = min(max(config.min_window_m, config.window_sigmas * float(sigma[k])), config.max_window_m)
            window_rad = min(max(0.1, config.window_sigmas * math.sqrt(variances[k, 1])), math.pi / 2)
            out.append((self._anchor(k), window_m, window_rad))
        return out

    def _anchor(self, k: int) -> int:
        half = self.config.segment_m / 2.0
        middle = (math.floor(self.travel_m[k] / half) + 0.5) * half
        return min(int(np.searchsorted(self.travel_m, middle)), len(self.travel_m) - 1)

    def _members(self, anchor: int, trailing: bool) -> range:
        """Keyframes within half a segment of the anchor (trailing: a whole segment before it)."""
        segment = self.config.segment_m
        low = self.travel_m[anchor] - (segment if trailing else segment / 2.0)
        high = self.travel_m[anchor] + (0.0 if trailing else segment / 2.0)
        return range(
            int(np.searchsorted(self.travel_m, low)), int(np.searchsorted(self.travel_m, high, side="right"))
        )

    # --- verification -------------------------------------------------------------------------------

    def _verify(
        self, place: Place, search_map, query: Place, guess: FloatArray, window_m: float, window_rad: float, sigma_m: float
    ) -> Loop | None:
        config, stats = self.config, self.statistics
        points = np.ascontiguousarray(query.surface[:, :2])
        found, score = search(search_map, points, guess, window_m, window_rad, config.min_score)
        if score == 0.0:
            stats.refuse("no match in the window")
            return None
        if window_m > config.lone_window_m:
            avoid = np.array([found[0], found[1], 1.0])
            _, runner_up = search(
                search_map, points, guess, window_m, window_rad, config.ambiguous_score * score, avoid
            )
            if runner_up > 0.0:
                stats.refuse("ambiguous")
                return None
        match = icp.register(
            place.table, points, np.ascontiguousarray(query.surface[:, 2:]), found, sigma_m, self.icp_config,
            search_radius_m=0.3,
        )  # fmt: skip
        there, seen_there = place.agreement(match.ref_T_src, query.surface)
        back, seen_back = query.agreement(_inverse(match.ref_T_src), place.surface)
        if max(seen_there, seen_back) < config.min_coverage or min(seen_there, seen_back) < 0.5 * config.min_coverage:
            stats.refuse("too little in common")
            return None
        if min(there, back) < config.min_agreement:
            stats.refuse("contradicted by free space")
            return None
        if match.inlier_ratio < config.min_inlier_ratio * max(seen_there, 0.5):
            stats.refuse("poor fit")
            return None
        return Loop(place.anchor, query.anchor, match, window_m)

    def _passes_gate(
        self, loop: Loop, world_T_body: FloatArray, relative_covariance: Callable[[int, int], FloatArray]
    ) -> bool:
        """chi2 of the loop under the joint marginal of both poses."""
        predicted = poses.between(world_T_body[loop.i], world_T_body[loop.j])
        error = poses.between(predicted, loop.match.ref_T_src)
        covariance = relative_covariance(loop.i, loop.j) + np.linalg.pinv(loop.match.information, hermitian=True)
        chi2 = float(error @ np.linalg.solve(covariance, error))
        if chi2 > CHI2_3DOF.get(self.gate, 16.27):
            self.statistics.refuse("outside the joint marginal")
            return False
        return True

    def _with_partners(self, loop: Loop) -> list[Loop]:
        """The loop and those that waited for it, once enough of them agree."""
        if loop.window_m <= self.config.lone_window_m:
            return [loop]
        agreeing = [w for w in self._waiting if self._agree(w, loop)]
        self._waiting.append(loop)
        if len(agreeing) < self.config.partners:
            self.statistics.refuse("waits for others that agree")
            return []
        for w in [*agreeing, loop]:
            self._waiting.remove(w)
        return [*agreeing, loop]

    def _agree(self, a: Loop, b: Loop) -> bool:
        """Whether two loops tell the same story about the two passes, the local frame being rigid."""
        travelled = abs(self.travel_m[a.j] - self.travel_m[b.j])
        apart = abs(self.travel_m[a.i] - self.travel_m[b.i])
        if not 0.5 <= travelled <= 20.0 or apart > 30.0:
            return False
        local = self.keyframes
        ai_T_bi = poses.between(local[a.i].local_T_body, local[b.i].local_T_body)
        aj_T_bj = poses.between(local[a.j].local_T_body, local[b.j].local_T_body)
        over_old = poses.compose(ai_T_bi, b.match.ref_T_src)
        over_new = poses.compose(a.match.ref_T_src, aj_T_bj)
        error = poses.between(over_old, over_new)
        tolerance_m = 0.15 + 0.02 * (travelled + apart)
        return math.hypot(error[0], error[1]) < tolerance_m and abs(error[2]) < 0.02 + 0.003 * (travelled + apart)


def adjacency(count: int, edges: list[Edge]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows (first, other, variances) of the graph for `kernels.reach`: the surest edge of each pair
    matters most, so all are kept."""
    usable = [e for e in edges if e.i != e.j and e.kind in ("scan", "loop")]
    i = np.array([e.i for e in usable], dtype=np.int64)
    j = np.array([e.j for e in usable], dtype=np.int64)
    var = np.array([edge_variances(e) for e in usable]).reshape(-1, 2)
    ends, others = np.concatenate([i, j]), np.concatenate([j, i])
    order = np.argsort(ends, kind="stable")
    first = np.searchsorted(ends[order], np.arange(count + 1))
    return first.astype(np.int64), others[order], np.concatenate([var, var])[order]


def edge_variances(edge: Edge) -> tuple[float, float]:
    covariance = np.linalg.inv(edge.information + np.diag([1.0, 1.0, 10.0]))
    return float(covariance[0, 0] + covariance[1, 1]), float(covariance[2, 2])


def _inverse(pose: FloatArray) -> FloatArray:
    return poses.between(pose, np.zeros(3))
