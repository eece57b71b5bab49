"""Scan after scan: predict, deskew, match against the recent past, choose keyframes."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field, replace

import numpy as np

from mfslam import ends, icp, recovery
from mfslam.config import Config
from mfslam.deskew import beam_times_s, deskew
from mfslam.inertia import Inertia
from mfslam.kernels import cells, matrices, poses
from mfslam.observability import OPEN_SIGMA_M, is_torn
from mfslam.odometry import step_sigmas
from mfslam.recovery import MAX_ACCELERATION, free_motion_sigmas
from mfslam.search import SearchMap
from mfslam.step_records import NOTHING_KNOWN, Keyframe, PredictedMotion, Step, trust
from mfslam.surfaces import merged_surface, placed
from mfslam.types import DeskewedScan, FloatArray, Match, Scan

SURPRISE_GATE = 3.0  # sigmas
MATCH_SIGMAS = np.array([0.01, 0.01, 0.005])  # of one match, beside those of the wheels (m, m, rad)
SEARCHED_SIGMAS = np.array([0.3, 0.3, 0.2])  # a searched pose holds only what the scan leaves open
GUESS_SIGMAS, FAR_M = 3.0, 5.0  # of what wheels predict, within which points this far off meet their partners
SEARCHED_M = 15.0  # of the recent map, about the robot
LOST_SHARE = 0.5  # of min_inlier_ratio: a scan that fits worse says nothing of where the robot is
JUMP_POINTS = 30  # so many more points must fit where a scan is said to stand against its prediction
ENDS_SIGMA_M = 0.02  # a match surer than this along its walls does not ask where they end
FEW_SHARE = 0.05  # of the beams that tell the way along walls, against those that tell the way across: too few to trust
JOINT_ROUNDS = 2  # of deskewing and solving for pose and twist


@dataclass(eq=False)
class Frontend:
    """Keeps a locally consistent frame (``local``) that never jumps; the graph corrects it globally."""

    config: Config
    recent: deque[Keyframe] = field(default_factory=deque)
    _recent_points: deque[FloatArray] = field(default_factory=deque)  # theirs (M, 4) in the local frame
    _recent_ends: deque[FloatArray] = field(default_factory=deque)  # of their walls (E, 5), without wheels
    _finds_news: bool = False  # there are such that no keyframe knows
    _ends: FloatArray = field(default_factory=lambda: ends.NO_ENDS)  # of the walls in this scan
    local_T_body: FloatArray = field(default_factory=lambda: np.zeros(3))
    reference: cells.CellTable | None = None
    place: SearchMap | None = None
    last_step: FloatArray = field(default_factory=lambda: np.zeros(3))
    wheels_since_keyframe: FloatArray = field(default_factory=lambda: np.zeros(3))
    wheels_trusted: bool = True
    inertia: Inertia = field(default_factory=Inertia)
    coasts: bool = True  # no wheels told the last step
    last_dt_s: float = 0.0
    blind_s: float = 0.0  # since the robot's pose was last known
    spacing: float = 1.0  # of keyframes, times what is configured: a live run on a slow machine widens it

    def __post_init__(self) -> None:
        self._step_noise = self.config.odometry.step_noise

    def process(self, index: int, scan: Scan, motion: PredictedMotion) -> Step:
        """Place one scan in the local frame."""
        config = self.config
        cloud = deskew(scan, motion.twist, config.deskew, config.icp.point_spacing_m)
        self._ends = (
            ends.NO_ENDS if motion.step is not None else ends.wall_ends(scan, motion.twist, config.deskew)
        )
        if self.reference is None:
            self.inertia.begin()
            self._add_keyframe(index, cloud)
            return Step(self.local_T_body, None, True)
        blind_s = self.blind_s + motion.dt_s + motion.pause_s
        coasted = recovery.coasted(self.last_step, self.last_dt_s, motion.dt_s + motion.pause_s)
        onward = predicted = self._coast(motion) if motion.step is None else motion.step
        self.coasts, self.last_dt_s = motion.step is None, motion.dt_s
        if motion.turn_rad is not None:
            predicted = np.array([predicted[0], predicted[1], motion.turn_rad])
        likely = motion.step is not None and recovery.is_likely(
            motion.step, self.last_step, coasted, motion.dt_s
        )
        if not likely and blind_s > recovery.BLIND_S:
            return self._after_blindness(index, scan, cloud, predicted, motion, blind_s)
        guess = poses.compose(self.local_T_body, predicted)
        self.wheels_since_keyframe = poses.compose(self.wheels_since_keyframe, predicted)
        self.wheels_trusted = self.wheels_trusted and motion.step is not None
        match = self._match(scan, cloud, guess, motion)
        step = poses.between(self.local_T_body, match.ref_T_src)
        surprise = self._surprise(predicted, step, motion)
        searched = False
        if match.inlier_ratio < config.frontend.min_inlier_ratio or surprise > SURPRISE_GATE:
            hopeless = match.inlier_ratio < LOST_SHARE * config.frontend.min_inlier_ratio
            beyond = coasted if hopeless or not likely else None
            better = self._search(scan, cloud, guess, match, beyond, self._reach(motion, blind_s))
            if better is not None:
                better_step = poses.between(self.local_T_body, better.ref_T_src)
                surprise_there = self._surprise(predicted, better_step, motion)
                # wheels hardly ever jump: it takes more than a few points to say so
                more = (better.inlier_ratio - match.inlier_ratio) * len(cloud.points_m)
                if motion.step is None or surprise_there <= SURPRISE_GATE or more >= JUMP_POINTS:
                    match, step, surprise, searched = better, better_step, surprise_there, True
        twist = motion.twist
        jump = motion.step is not None and surprise > SURPRISE_GATE
        if jump:
            self.wheels_trusted = False
        if (motion.step is None or jump) and motion.dt_s > 0.0 and config.deskew.mode != "none":
            # nobody told the motion within the scan: it is found with the match, and the scan matched again
            twist, guess = self._motion_within(scan, match, onward, step, motion, searched)
            cloud = deskew(scan, twist, config.deskew, config.icp.point_spacing_m)
            again = self._match(scan, cloud, guess, motion, free=searched)
            if again.inlier_ratio > match.inlier_ratio - 0.05:
                match, step = again, poses.between(self.local_T_body, again.ref_T_src)
        self.local_T_body, self.last_step = match.ref_T_src, step
        if self.coasts:
            off = poses.log(poses.between(onward, step))
            information = trust(match) * match.information
            self.inertia.found(off, information if match.by_ends is None else information + match.by_ends)
            self.last_step = poses.advance(np.zeros(3), self.inertia.step, 1.0)
        lost = match.inlier_ratio < LOST_SHARE * config.frontend.min_inlier_ratio
        self.blind_s = blind_s if lost and not likely else 0.0
        moved = poses.between(self.recent[-1].local_T_body, self.local_T_body)
        is_keyframe = math.hypot(
            moved[0], moved[1]
        ) >= self.spacing * config.frontend.keyframe_distance_m or abs(
            moved[2]
        ) >= self.spacing * math.radians(config.frontend.keyframe_angle_deg)
        unseen = self.inertia.unseen(moved) if self.coasts else None
        # what is seen after a way that nothing told is held on to at once
        is_keyframe = is_keyframe or (unseen is not None and (self._finds_news or is_torn(unseen)))
        if is_keyframe:
            self._add_keyframe(index, cloud)
        return Step(self.local_T_body, match, is_keyframe, searched, jump, twist=twist, unseen=unseen)

    def _coast(self, motion: PredictedMotion) -> FloatArray:
        """The step (3,) by inertia."""
        if not self.coasts:  # as the last wheels told
            self.inertia.told(self.last_step, self.last_dt_s, MATCH_SIGMAS)
            self.inertia.mark()
        return self.inertia.go_on(motion.dt_s + motion.pause_s)

    def _reach(self, motion: PredictedMotion, blind_s: float) -> tuple[float, float]:
        """How far (m, rad) the robot can be from where it is expected."""
        half_m, half_rad = recovery.reach(blind_s)
        if motion.step is None:
            x, y, theta = (recovery.REACH_SIGMAS * self.inertia.sigmas).tolist()
            half_m, half_rad = max(half_m, x, y), max(half_rad, min(theta, math.pi))
        return half_m, half_rad

    def _motion_within(
        self,
        scan: Scan,
        match: Match,
        onward: FloatArray,
        step: FloatArray,
        motion: PredictedMotion,
        searched: bool,
    ) -> tuple[FloatArray, FloatArray]:
        """Twist (3,) through a scan that no wheels tell of, and where the scan stands with it.

        The mean motion since the scan before, or, with `frontend.joint_twist`, what the scan's own
        distortion says: as far from that mean as the robot may have accelerated.
        """
        config = self.config
        dt_s = max(motion.dt_s, 0.02)
        off = poses.log(poses.between(onward, step))
        twist = poses.log(step) / dt_s if motion.step is not None else self.inertia.twist_if(off)
        if not config.frontend.joint_twist or config.deskew.mode != "pose":
            return twist, match.ref_T_src
        assert self.reference is not None
        mean, pose = twist, match.ref_T_src
        sigmas = np.concatenate([free_motion_sigmas(dt_s), MAX_ACCELERATION * dt_s])
        if searched:
            sigmas[:3] = SEARCHED_SIGMAS
        information = np.diag(sigmas**-2)
        for _ in range(JOINT_ROUNDS):
            cloud = deskew(scan, twist, config.deskew, config.icp.point_spacing_m)
            pose, change = icp.register_moving(
                self.reference, cloud, beam_times_s(scan.laser)[cloud.beams], pose, match.ref_T_src,
                mean - twist, information, scan.laser.range_sigma_m, config.icp,
            )  # fmt: skip
            twist = twist + change
        return twist, pose

    def _surprise(self, predicted: FloatArray, step: FloatArray, motion: PredictedMotion) -> float:
        """How far a step lies from its prediction, in sigmas of the worst direction."""
        if motion.step is None:
            sigmas = MATCH_SIGMAS + self.inertia.sigmas
        else:
            sigmas = MATCH_SIGMAS + 2.0 * motion.noise_scale * step_sigmas(predicted, self._step_noise)
        return float(poses.off_in_sigmas(predicted, step, sigmas))

    def _match(
        self, scan: Scan, cloud: DeskewedScan, guess: FloatArray, motion: PredictedMotion, free: bool = False
    ) -> Match:
        """ICP from ``guess``; what the scan leaves open is held by the wheels' motion since the keyframe,
        or, without wheels, by inertia. ``free``: by hardly anything, for a guess that was searched."""
        assert self.reference is not None
        config, prior = self.config.icp, guess
        radius_m = config.search_radius_m
        if free:
            sigmas = SEARCHED_SIGMAS
        elif motion.step is None:
            # a match counts every beam, of which only a share is independent
            match = icp.register(
                self.reference, cloud.points_m, cloud.normals, guess, scan.laser.range_sigma_m, config,
                prior_information=self.inertia.information / config.independent_share,
            )  # fmt: skip
            return self._along_walls(match, guess)
        elif self.wheels_trusted:
            prior = poses.compose(self.recent[-1].local_T_body, self.wheels_since_keyframe)
            sigmas = motion.noise_scale * step_sigmas(self.wheels_since_keyframe, self._step_noise)
            off_m, _, off_rad = (motion.noise_scale * step_sigmas(motion.step, self._step_noise)).tolist()
            radius_m = min(radius_m, config.final_radius_m + GUESS_SIGMAS * (off_m + FAR_M * off_rad))
        else:
            sigmas = free_motion_sigmas(motion.dt_s)
        return icp.register(
            self.reference, cloud.points_m, cloud.normals, guess, scan.laser.range_sigma_m,
            config, prior, sigmas, radius_m,
        )  # fmt: skip

    def _along_walls(self, match: Match, guess: FloatArray) -> Match:
        """A match whose walls hardly tell the way along them, moved to where they end, or, where inertia does not allow what few
        beams say, left to inertia: what they meet moves itself, a person who walks ahead or a door."""
        self._finds_news = False
        (a, b, _), (_, d, _), _ = match.information.tolist()
        middle, half = 0.5 * (a + d), math.hypot(0.5 * (a - d), b)
        # what the match says of the way along the walls, and of that across
        by_beams, across = middle - half, middle + half
        if by_beams > ENDS_SIGMA_M**-2:
            return match
        told_by_few = by_beams < FEW_SHARE * across
        _, *direction = matrices.open_direction(match.information, 1.0)
        along = np.array([*direction, 0.0])
        by_inertia = 1.0 / float(along @ self.inertia.covariance[:3, :3] @ along)
        moved_m = float(along @ poses.between(guess, match.ref_T_src))  # from where inertia leads
        by_ends = self._shift_to_ends(match.ref_T_src, along, by_inertia**-0.5)
        if by_ends is not None:
            shift_m, sigma_m = by_ends
            told = sigma_m**-2.0
            by_match, pull = (0.0, -by_inertia * moved_m) if told_by_few else (by_beams, 0.0)
            off_m = (told * shift_m + pull) / (told + by_inertia + by_match)
        else:
            # the match and inertia together have moved it by the share of the match
            if not told_by_few or by_beams <= 0.0:
                return match
            alone_m = moved_m * (1.0 + by_inertia / by_beams)
            if abs(alone_m) <= SURPRISE_GATE * math.sqrt(1.0 / by_beams + 1.0 / by_inertia):
                return match
            off_m, told = -moved_m, 0.0
        information = matrices.drop_open_direction(match.information, FEW_SHARE)
        return replace(
            match,
            ref_T_src=poses.advance(match.ref_T_src, along, off_m),
            information=information,
            by_ends=told * np.outer(along, along) if told > 0.0 else None,
        )

    def _shift_to_ends(
        self, pose: FloatArray, along: FloatArray, sigma_m: float
    ) -> tuple[float, float] | None:
        """`ends.shift_along` a direction (3,) of the body that is known with ``sigma_m`` there."""
        c, s = math.cos(pose[2]), math.sin(pose[2])
        direction = np.array([c * along[0] - s * along[1], s * along[0] + c * along[1]])
        seen = ends.along(ends.placed(self._ends, pose), direction)
        if len(seen) < ends.LEAST_ENDS:
            return None
        known = ends.along(np.concatenate(self._recent_ends), direction)
        found = ends.shift_along(seen, known, direction, SURPRISE_GATE * sigma_m + ENDS_SIGMA_M)
        self._finds_news = found is None
        return found

    def _search(
        self,
        scan: Scan,
        cloud: DeskewedScan,
        guess: FloatArray,
        match: Match,
        coasted: FloatArray | None,
        reach: tuple[float, float],
    ) -> Match | None:
        """A clearly better fit than ``match`` near ``guess`` or, alone within ``reach``, where inertia leads (``coasted``, the
        step), by correlative search over the recent map and ICP from there; None when there is none."""
        place = self._recent_map(guess)
        if place is None:
            return None
        near = recovery.place_near(place, cloud.points_m, guess, self.config.frontend)
        if near is not None:
            better = self._match(scan, cloud, near, NOTHING_KNOWN, free=True)
            if better.inlier_ratio > match.inlier_ratio + recovery.NEAR_MARGIN:
                return better
            if match.inlier_ratio >= self.config.frontend.min_inlier_ratio:
                return None
        if coasted is None:
            return None
        return self._only_fit(
            scan, cloud, poses.compose(self.local_T_body, coasted), reach,
            match.inlier_ratio + recovery.FAR_MARGIN,
        )  # fmt: skip

    def _recent_map(self, center: FloatArray) -> SearchMap | None:
        """The recent surface, ready to be searched; None where nothing was seen yet."""
        assert self.reference is not None
        if self.place is None and len(self.reference[1]):
            self.place = SearchMap.of(self.reference[1][:, :2], center[:2], SEARCHED_M, 0.1)
        return self.place

    def _after_blindness(
        self,
        index: int,
        scan: Scan,
        cloud: DeskewedScan,
        predicted: FloatArray,
        motion: PredictedMotion,
        blind_s: float,
    ) -> Step:
        """Place a scan before which nobody watched the robot for a while: where alone it looks like the
        recent map, or, without such a place, at the beginning of a new map that loops may join."""
        guess = poses.compose(self.local_T_body, predicted)
        reach, least = recovery.reach(blind_s), self.config.frontend.min_inlier_ratio
        match = self._only_fit(scan, cloud, guess, reach, least)
        if match is None:
            self.local_T_body = guess
            self.recent.clear()
            self._recent_points.clear()
            self._recent_ends.clear()
        else:
            self.local_T_body = match.ref_T_src
        self.last_step, self.last_dt_s, self.blind_s = np.zeros(3), 0.0, 0.0
        self.inertia.begin()
        self.coasts = True
        self._add_keyframe(index, cloud)
        return Step(
            self.local_T_body, match, True, searched=True, odometry_jump=motion.step is not None,
            blind_s=blind_s, found=match is not None,
        )  # fmt: skip

    def _only_fit(
        self, scan: Scan, cloud: DeskewedScan, center: FloatArray, reach: tuple[float, float], least: float
    ) -> Match | None:
        """The fit of a scan within ``reach`` of ``center``, if a share ``least`` of it fits, it tells where along every
        direction, and none elsewhere comes near it."""
        place = self._recent_map(center)
        if place is None:
            return None
        found = recovery.places_within_reach(place, cloud.points_m, center, reach, self.config.frontend)
        fits = [self._match(scan, cloud, pose, NOTHING_KNOWN, free=True) for pose in found]
        fits.sort(key=lambda fit: -fit.inlier_ratio)
        if not fits or fits[0].inlier_ratio < least or is_open(fits[0]):
            return None
        for rival in fits[1:]:
            off = poses.between(fits[0].ref_T_src, rival.ref_T_src)
            elsewhere = math.hypot(off[0], off[1]) > 0.3 or abs(off[2]) > 0.1
            if elsewhere and rival.inlier_ratio > fits[0].inlier_ratio - recovery.FAR_MARGIN:
                return None
        return fits[0]

    def _add_keyframe(self, index: int, cloud: DeskewedScan) -> None:
        self.recent.append(Keyframe(index, cloud, self.local_T_body))
        self._recent_points.append(placed(cloud, self.local_T_body))
        self._recent_ends.append(ends.placed(self._ends, self.local_T_body))
        if len(self.recent) > self.config.frontend.local_keyframes:
            self.recent.popleft()
            self._recent_points.popleft()
            self._recent_ends.popleft()
        self.inertia.mark()
        self.wheels_since_keyframe = np.zeros(3)
        self.wheels_trusted = True
        self.reference = merged_surface(self._recent_points)
        self.place = None


def is_open(match: Match) -> bool:
    """Whether a match leaves a direction of translation open."""
    return bool(np.linalg.eigvalsh(match.information[:2, :2])[0] < OPEN_SIGMA_M**-2)
