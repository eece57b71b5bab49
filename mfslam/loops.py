"""Loop closure: candidates by the graph's uncertainty, a search as wide as it, verification, and several
that agree before any from a wide search is believed."""

from __future__ import annotations

import bisect
import math
from array import array
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from itertools import islice

import numpy as np

from mfslam import icp
from mfslam.config import Config
from mfslam.kernels import poses
from mfslam.loop_records import Candidate, Fit, Loop, LoopStatistics, apart
from mfslam.places import Place, PlaceMemory
from mfslam.search import MAX_HYPOTHESES, hypotheses, search
from mfslam.skeleton import Skeleton
from mfslam.step_records import Keyframe
from mfslam.types import FloatArray, IntArray, Match
from mfslam.uncertainty import chi2_quantile

GAP_M = 100.0  # driven, as it were, where nothing ties two keyframes: what is within so much is rigid

# times that a place may fit nothing that is seen from one spot: then it cannot be seen from there
MOST_MISSES = 3
AGREE_WITHIN_M = 20.0  # of driving between two loops that tell the same story


class LoopCloser:
    """Watches the keyframes go by and proposes loop edges."""

    def __init__(self, config: Config, keyframes: list[Keyframe]) -> None:
        self.config = config.loops
        self.icp_config = config.icp
        self.gate_chi2 = chi2_quantile(config.graph.gate_probability)
        self.keyframes = keyframes
        self.travel_m = array("d")
        self._tears = array("q")  # keyframes before which the path is torn
        self.statistics = LoopStatistics()
        # a spot that is known as well as a few matches would know it is left alone, however often it is passed
        self._known_m = self.config.gain_sigmas * math.sqrt(2.0) * self.config.sigma_floor_m
        self._known_rad = self.config.gain_sigmas * math.radians(self.config.sigma_floor_deg)
        self.skeleton = Skeleton(self._known_m, self._known_rad)
        self._memory = PlaceMemory(keyframes)
        self._last_search_m = 0.0
        self._last_wide_m = -math.inf
        self._waiting: list[Loop] = []
        self._misses: dict[tuple[int, int], int] = {}  # of a stretch of path that was tried from a knot
        self._tied_at_m: dict[int, float] = {}  # stretch of path -> travel when it was last tied to

    def add_keyframe(self, torn: bool = False) -> None:
        """Note the newest keyframe; call once for each. ``torn``: how the robot came there is not known, so no
        place and no story spans this step."""
        if not self.travel_m:
            self.travel_m.append(0.0)
            return
        if torn:
            self._tears.append(len(self.keyframes) - 1)
        a, b = self.keyframes[-2].local_T_body, self.keyframes[-1].local_T_body
        step_m = GAP_M if torn else math.hypot(b[0] - a[0], b[1] - a[1])
        self.travel_m.append(self.travel_m[-1] + step_m)

    def release(self) -> None:
        """Drop the places and the skeleton; the statistics stay."""
        self._memory = PlaceMemory(self.keyframes)
        self.skeleton = Skeleton(self._known_m, self._known_rad)
        self._waiting = []

    def due(self) -> bool:
        return self.config.use and self.travel_m[-1] - self._last_search_m >= self.config.every_m

    def search(self, world_T_body: FloatArray, range_sigma_m: float) -> list[Loop]:
        """Loops of the newest keyframe that are to be believed. ``world_T_body`` (K, 3): the estimate."""
        self.statistics.searches += 1
        self._last_search_m = self.travel_m[-1]
        j = len(self.keyframes) - 1
        candidates = self._candidates(j, world_T_body)
        if not candidates:
            return []
        query = Place.of(self.keyframes, self._members(j, trailing=True), j)
        found = []
        for candidate in candidates:
            self.statistics.places_tried += 1
            loop = self._match(candidate, query, world_T_body, range_sigma_m)
            if loop is not None:
                found.append(loop)
            elif candidate.window_m <= self.config.wide_window_m:
                pair = self.skeleton.knot_of(j), self._stretch(candidate.keyframe)
                self._misses[pair] = self._misses.get(pair, 0) + 1
        believed: list[Loop] = []
        for loop in self._unambiguous(found, world_T_body):
            is_inside = partial(self._passes_gate, loop, world_T_body)
            believed += self._with_partners(loop, is_inside)
        self.statistics.accepted += len(believed)
        self._tied_at_m.update((self._stretch(loop.i), self.travel_m[loop.j]) for loop in believed)
        return believed

    # --- candidates ---------------------------------------------------------------------------------

    def _candidates(self, j: int, world_T_body: FloatArray) -> list[Candidate]:
        """Old places that the newest keyframe may see, the nearest first."""
        config, here_m = self.config, self.travel_m[j]
        knots = self.skeleton.knots
        travel_m = np.frombuffer(self.travel_m)[knots]
        is_old = travel_m <= here_m - config.min_travel_m
        if not is_old.any():
            return []
        sigma_m, sigma_rad = self.skeleton.seen_from(j, world_T_body)
        distance = np.hypot(*(world_T_body[knots, :2] - world_T_body[j, :2]).T)
        window = config.window_sigmas * sigma_m
        near = np.flatnonzero(is_old & (distance < config.reach_m * 0.75 + window))
        # one place per half segment of path: passes by the same spot count apart
        near = near[np.argsort(distance[near], kind="stable")]
        stretches = (travel_m[near] / (config.segment_m / 2.0)).astype(np.int64)
        best = near[np.sort(np.unique(stretches, return_index=True)[1])]
        best = best[(sigma_m[best] > self._known_m) | (sigma_rad[best] > self._known_rad)]
        are_wide = window[best] > config.wide_window_m

        def candidates(among: IntArray) -> Iterator[Candidate]:
            for k in among.tolist():
                window_rad = max(0.1, config.window_sigmas * float(sigma_rad[k]))
                window_m = max(config.min_window_m, float(window[k]))
                yield Candidate(self._anchor(int(knots[k])), window_m, min(window_rad, math.pi))

        here = self.skeleton.knot_of(j)
        untied = (c for c in candidates(best[~are_wide]) if not self._tied_lately(c))
        likely = (c for c in untied if self._misses.get((here, self._stretch(c.keyframe)), 0) < MOST_MISSES)
        sure = list(islice(likely, config.max_near_places))
        wide = list(candidates(best[are_wide][: config.max_places]))
        if wide and here_m - self._last_wide_m >= config.wide_every_m:
            self._last_wide_m = here_m
            return sure + wide
        return sure

    def _tied_lately(self, candidate: Candidate) -> bool:
        """Whether this stretch of path was tied to the same place already: once more says nothing new."""
        last_m = self._tied_at_m.get(self._stretch(candidate.keyframe))
        return last_m is not None and self.travel_m[-1] - last_m < self.config.segment_m / 2.0

    def _anchor(self, k: int) -> int:
        """The keyframe in the middle of the half segment of keyframe k, or the last one before it where the path is torn."""
        half_m = self.config.segment_m / 2.0
        middle = bisect.bisect_left(self.travel_m, (self._stretch(k) + 0.5) * half_m)
        if middle == len(self.travel_m) or self._stretch(middle) > self._stretch(k):
            middle -= 1
        return middle

    def _stretch(self, k: int) -> int:
        """Number of the half segment of path that keyframe k lies on."""
        return int(self.travel_m[k] / (self.config.segment_m / 2.0))

    def _members(self, anchor: int, trailing: bool) -> range:
        """Keyframes within half a segment of the anchor (trailing: a whole segment before it)."""
        segment = self.config.segment_m
        low = self.travel_m[anchor] - (segment if trailing else segment / 2.0)
        high = self.travel_m[anchor] + (0.0 if trailing else segment / 2.0)
        return range(bisect.bisect_left(self.travel_m, low), bisect.bisect_right(self.travel_m, high))

    # --- search and verification ----------------------------------------------------------------------

    def _match(
        self, candidate: Candidate, query: Place, world_T_body: FloatArray, range_sigma_m: float
    ) -> Loop | None:
        """The best pose of the query in the candidate's place, if it stands up to verification."""
        config = self.config
        place = self._memory.at(self._members(candidate.keyframe, trailing=False), candidate.keyframe)
        points = query.points_m
        wide = candidate.window_m > config.wide_window_m
        center = poses.between(world_T_body[place.anchor], world_T_body[query.anchor])
        window_m = candidate.window_m
        if wide:
            # only poses that overlap the place are worth a look
            distance = math.hypot(center[0], center[1])
            window_m = min(window_m, config.reach_m)
            if distance > config.reach_m:
                center[:2] *= max(0.0, 1.0 - candidate.window_m / distance)
        if wide:
            found = hypotheses(
                place.coarse_map,
                points,
                center,
                window_m,
                candidate.window_rad,
                config.min_score,
                config.ambiguous_score,
            )
            found = [search(place.fine_map, points, pose, 0.3, 0.06, config.min_score) for pose, _ in found]
        else:
            found = [search(place.fine_map, points, center, window_m, candidate.window_rad, config.min_score)]
        found = [(pose, score) for pose, score in found if score > 0.0]
        if not found:
            self.statistics.refuse("no match in the window")
            return None
        if len(found) > MAX_HYPOTHESES:
            self.statistics.refuse("ambiguous")
            return None
        fits = [self._fit(place, query, pose, score, wide, range_sigma_m) for pose, score in found]
        # one that only sees too little is no less likely for that
        standing = [fit for fit in fits if fit.refused not in ("contradicted by free space", "poor fit")]
        best = max(standing or fits, key=lambda fit: fit.score)
        if any(apart(best.match.ref_T_src, fit.match.ref_T_src) for fit in standing):
            self.statistics.refuse("ambiguous")
            return None
        if best.refused is not None:
            self.statistics.refuse(best.refused)
            return None
        # the search looks into whole blocks: what it finds beside its window may be told from others, but is not believed
        beside = np.abs(best.match.ref_T_src[:2] - center[:2]).max() - window_m
        if beside > config.min_window_m:
            self.statistics.refuse("beside its window")
            return None
        floor = (config.sigma_floor_m, math.radians(config.sigma_floor_deg))
        match = replace(best.match, information=icp.with_floor(best.match.information, *floor))
        return Loop(place.anchor, query.anchor, match, candidate.window_m, best.score)

    def _fit(
        self, place: Place, query: Place, pose: FloatArray, score: float, wide: bool, range_sigma_m: float
    ) -> Fit:
        match = icp.register(
            place.table, query.points_m, query.normals, pose, range_sigma_m, self.icp_config, search_radius_m=0.3,
        )  # fmt: skip
        return Fit(match, score, self._refusal(place, query, match, wide))

    def _refusal(self, place: Place, query: Place, match: Match, wide: bool) -> str | None:
        """Why a match is not to be believed; None where enough is in common, what is in common fits closely,
        and nothing stands in seen free space."""
        config = self.config
        there, seen_there = place.agreement(match.ref_T_src, query)
        back, seen_back = query.agreement(poses.between(match.ref_T_src, np.zeros(3)), place)
        if max(seen_there, seen_back) < config.min_coverage or min(seen_there, seen_back) < 0.2:
            return "too little in common"
        wanted = config.min_agreement
        if wide:
            is_torn = self._tears_before(place.anchor) < self._tears_before(query.anchor)
            wanted = config.torn_agreement if is_torn else config.wide_agreement
        if min(there, back) < wanted - 0.1 or 0.5 * (there + back) < wanted:
            return "contradicted by free space"
        if np.linalg.eigvalsh(match.information[:2, :2])[0] < config.max_sigma_m**-2:
            return "open in a direction"
        wanted = config.wide_inlier_ratio if wide else config.min_inlier_ratio
        return "poor fit" if match.inlier_ratio < wanted * seen_there else None

    def _tears_before(self, k: int) -> int:
        """How often the path is torn on the way to keyframe k."""
        return bisect.bisect(self._tears, k)

    def _unambiguous(self, found: list[Loop], world_T_body: FloatArray) -> list[Loop]:
        """Loops from wide windows must not tell of two places for one scan."""
        wide = [loop for loop in found if loop.window_m > self.config.wide_window_m]
        sure = [loop for loop in found if loop.window_m <= self.config.wide_window_m]
        if not wide:
            return sure
        best = max(wide, key=lambda loop: loop.score)
        here = poses.compose(world_T_body[best.i], best.match.ref_T_src)
        kept = []
        for loop in wide:
            if not apart(here, poses.compose(world_T_body[loop.i], loop.match.ref_T_src), 1.0):
                kept.append(loop)
            elif loop.score > self.config.ambiguous_score * best.score:
                self.statistics.refuse("ambiguous")
                return sure
        return sure + kept

    def _passes_gate(self, loop: Loop, world_T_body: FloatArray) -> bool:
        """chi2 of the loop under the joint marginal of both poses."""
        predicted = poses.between(world_T_body[loop.i], world_T_body[loop.j])
        error = poses.between(predicted, loop.match.ref_T_src)
        own = loop.match.information + 1e-6 * np.eye(3)
        if float(error @ own @ error) < self.gate_chi2:
            return True  # within its own noise: what the graph is unsure of beyond that only widens the gate
        covariance = self.skeleton.relative_covariance(loop.i, loop.j, world_T_body) + np.linalg.inv(own)
        return float(error @ np.linalg.solve(covariance, error)) < self.gate_chi2

    def _with_partners(self, loop: Loop, is_inside: Callable[[], bool]) -> list[Loop]:
        """The loop and those that waited for it, once enough of them agree.

        One that lies outside the joint marginal (``is_inside``: whether it does, asked only where that decides)
        needs twice as many: then not the loop is wrong but a match on the way, and the robust solve is left to
        find it.
        """
        config = self.config
        is_sure = loop.window_m <= config.wide_window_m
        if is_sure and is_inside():
            return [loop]
        # those that wait from too far back can agree with nothing any more
        newest_m = self.travel_m[loop.j]
        self._waiting = [w for w in self._waiting if newest_m - self.travel_m[w.j] <= AGREE_WITHIN_M]
        agreeing = [w for w in self._waiting if self._agree(w, loop)]
        self._waiting.append(loop)
        distinct = len({w.j for w in agreeing})
        if not is_sure and distinct < config.partners:
            self.statistics.refuse("waits for others that agree")
            return []
        if distinct < 2 * config.partners and (is_sure or not is_inside()):
            self.statistics.refuse("outside the joint marginal")
            return []
        self._waiting = [w for w in self._waiting if w is not loop and w not in agreeing]
        return [*agreeing, loop]

    def _agree(self, a: Loop, b: Loop) -> bool:
        """Whether two loops tell the same story about the two passes, the local frame being rigid."""
        travelled = abs(self.travel_m[a.j] - self.travel_m[b.j])
        apart = abs(self.travel_m[a.i] - self.travel_m[b.i])
        if not 0.5 <= travelled <= AGREE_WITHIN_M or apart > 30.0:
            return False
        local = self.keyframes
        ai_T_bi = poses.between(local[a.i].local_T_body, local[b.i].local_T_body)
        aj_T_bj = poses.between(local[a.j].local_T_body, local[b.j].local_T_body)
        over_old = poses.compose(ai_T_bi, b.match.ref_T_src)
        over_new = poses.compose(a.match.ref_T_src, aj_T_bj)
        error = poses.between(over_old, over_new)
        path_m = travelled + apart
        return math.hypot(error[0], error[1]) < 0.15 + 0.02 * path_m and abs(error[2]) < 0.02 + 0.003 * path_m
