"""Scan after scan: predict, deskew, match against the recent past, choose keyframes."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from mfslam import icp
from mfslam.config import Config
from mfslam.deskew import beam_times_s, deskew
from mfslam.kernels import cells, poses
from mfslam.odometry import step_sigmas
from mfslam.search import SearchMap, search
from mfslam.types import DeskewedScan, FloatArray, IntArray, Match, Scan

SURPRISE_GATE = 3.0  # sigmas
SMOOTHING_M, SURFACE_SPACING_M = 0.1, 0.04  # of surfaces made of several scans
MATCH_SIGMAS = np.array([0.01, 0.01, 0.005])  # of one match, beside those of the wheels (m, m, rad)
SEARCHED_SIGMAS = np.array([0.3, 0.3, 0.2])  # a searched pose holds only what the scan leaves open
JOINT_ROUNDS = 2  # of deskewing and solving for pose and twist
MAX_ACCELERATION = np.array([2.0, 0.5, 4.0])  # of a robot whose wheels are not known (m/s^2, rad/s^2)


@dataclass(frozen=True, eq=False, slots=True)
class PredictedMotion:
    """What is known of the motion before a scan is matched.

    ``twist`` (3,): body velocity during the scan. ``dt_s``: time since the previous scan. ``step`` (3,):
    wheel motion since the previous scan; None without wheels. ``turn_rad``: the gyro's turn since then.
    ``noise_scale`` (3,): how many times noisier than configured the wheels turned out to be.
    """

    twist: FloatArray
    dt_s: float
    step: FloatArray | None = None
    turn_rad: float | None = None
    noise_scale: FloatArray = field(default_factory=lambda: np.ones(3))


NOTHING_KNOWN = PredictedMotion(np.zeros(3), 0.0)


@dataclass(eq=False, slots=True)
class Keyframe:
    """A scan that the graph holds a pose for."""

    scan_index: int
    cloud: DeskewedScan
    local_T_body: FloatArray


@dataclass(eq=False, slots=True)
class Step:
    """What the front end made of one scan."""

    local_T_body: FloatArray
    match: Match | None
    is_keyframe: bool
    searched: bool = False
    odometry_jump: bool = False


@dataclass(eq=False)
class Frontend:
    """Keeps a locally consistent frame (``local``) that never jumps; the graph corrects it globally."""

    config: Config
    recent: deque[Keyframe] = field(default_factory=deque)
    local_T_body: FloatArray = field(default_factory=lambda: np.zeros(3))
    reference: cells.CellTable | None = None
    place: SearchMap | None = None
    last_step: FloatArray = field(default_factory=lambda: np.zeros(3))
    wheels_since_keyframe: FloatArray = field(default_factory=lambda: np.zeros(3))
    wheels_trusted: bool = True

    def process(self, index: int, scan: Scan, motion: PredictedMotion) -> Step:
        """Place one scan in the local frame."""
        config = self.config
        cloud = deskew(scan, motion.twist, config.deskew, config.icp.point_spacing_m)
        if self.reference is None:
            self._add_keyframe(index, cloud)
            return Step(self.local_T_body, None, True)
        predicted = self.last_step if motion.step is None else motion.step
        if motion.turn_rad is not None:
            predicted = np.array([predicted[0], predicted[1], motion.turn_rad])
        guess = poses.compose(self.local_T_body, predicted)
        self.wheels_since_keyframe = poses.compose(self.wheels_since_keyframe, predicted)
        self.wheels_trusted = self.wheels_trusted and motion.step is not None
        match = self._match(scan, cloud, guess, motion)
        step = poses.between(self.local_T_body, match.ref_T_src)
        surprise = self._surprise(predicted, step, motion)
        searched = False
        if match.inlier_ratio < config.frontend.min_inlier_ratio or surprise > SURPRISE_GATE:
            better = self._search(scan, cloud, guess, match)
            if better is not None:
                match, searched = better, True
                step = poses.between(self.local_T_body, match.ref_T_src)
                surprise = self._surprise(predicted, step, motion)
        jump = motion.step is not None and surprise > SURPRISE_GATE
        if jump:
            self.wheels_trusted = False
        if (motion.step is None or jump) and motion.dt_s > 0.0 and config.deskew.mode != "none":
            # nobody told the motion within the scan: it is found with the match, and the scan matched again
            twist, guess = self._motion_within(scan, match, step, motion, searched)
            cloud = deskew(scan, twist, config.deskew, config.icp.point_spacing_m)
            again = self._match(scan, cloud, guess, motion, free=searched)
            if again.inlier_ratio > match.inlier_ratio - 0.05:
                match, step = again, poses.between(self.local_T_body, again.ref_T_src)
        self.local_T_body, self.last_step = match.ref_T_src, step
        moved = poses.between(self.recent[-1].local_T_body, self.local_T_body)
        is_keyframe = math.hypot(moved[0], moved[1]) >= config.frontend.keyframe_distance_m or abs(
            moved[2]
        ) >= math.radians(config.frontend.keyframe_angle_deg)
        if is_keyframe:
            self._add_keyframe(index, cloud)
        return Step(self.local_T_body, match, is_keyframe, searched, jump)

    def _motion_within(
        self, scan: Scan, match: Match, step: FloatArray, motion: PredictedMotion, searched: bool
    ) -> tuple[FloatArray, FloatArray]:
        """Twist (3,) through a scan that no wheels tell of, and where the scan stands with it.

        The mean motion since the scan before, or, with `frontend.joint_twist`, what the scan's own
        distortion says: as far from that mean as the robot may have accelerated.
        """
        config = self.config
        dt_s = max(motion.dt_s, 0.02)
        twist = poses.log(step) / dt_s
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
        error = poses.between(predicted, step)
        sigmas = MATCH_SIGMAS + (
            free_motion_sigmas(motion.dt_s)
            if motion.step is None
            else 2.0 * motion.noise_scale * step_sigmas(predicted, self.config.odometry)
        )
        return float(np.max(np.abs(error) / sigmas))

    def _match(
        self, scan: Scan, cloud: DeskewedScan, guess: FloatArray, motion: PredictedMotion, free: bool = False
    ) -> Match:
        """ICP from ``guess``; what the scan leaves open is held by the wheels' motion since the keyframe,
        or, without wheels, by inertia. ``free``: by hardly anything, for a guess that was searched."""
        assert self.reference is not None
        if free:
            prior, sigmas = guess, SEARCHED_SIGMAS
        elif self.wheels_trusted:
            prior = poses.compose(self.recent[-1].local_T_body, self.wheels_since_keyframe)
            sigmas = motion.noise_scale * step_sigmas(self.wheels_since_keyframe, self.config.odometry)
        else:
            prior, sigmas = guess, free_motion_sigmas(motion.dt_s)
        return icp.register(
            self.reference, cloud.points_m, cloud.normals, guess, scan.laser.range_sigma_m,
            self.config.icp, prior, np.diag(sigmas**-2),
        )  # fmt: skip

    def _search(self, scan: Scan, cloud: DeskewedScan, guess: FloatArray, match: Match) -> Match | None:
        """A clearly better fit than ``match`` near ``guess``, by correlative search over the recent map and
        ICP from there; None when there is none."""
        assert self.reference is not None
        config = self.config.frontend
        if not len(self.reference[3]):
            return None  # nothing was seen yet
        if self.place is None:
            self.place = SearchMap.of(self.reference[3][:, :2], guess[:2], 15.0, 0.1)
        # most poor fits are a small slip: the wide window is opened only when the narrow one fails,
        # and the farther an answer may lie the more it has to be better
        for share, margin in ((0.35, 0.08), (1.0, 0.2)):
            found, score = search(
                self.place,
                cloud.points_m,
                guess,
                share * config.search_window_m,
                math.radians(share * config.search_angle_deg),
                0.4,
            )
            if score > 0.0:
                better = self._match(scan, cloud, found, NOTHING_KNOWN, free=True)
                if better.inlier_ratio > match.inlier_ratio + margin:
                    return better
            if match.inlier_ratio >= config.min_inlier_ratio:
                break
        return None

    def _add_keyframe(self, index: int, cloud: DeskewedScan) -> None:
        self.recent.append(Keyframe(index, cloud, self.local_T_body))
        if len(self.recent) > self.config.frontend.local_keyframes:
            self.recent.popleft()
        self.wheels_since_keyframe = np.zeros(3)
        self.wheels_trusted = True
        self.reference = merged_surface([k.cloud for k in self.recent], [k.local_T_body for k in self.recent])
        self.place = None


def free_motion_sigmas(dt_s: float) -> FloatArray:
    """One-sigma change (3,) of the next step of a robot that nobody watches: inertia bounds it."""
    return 0.02 + 0.5 * MAX_ACCELERATION * min(max(dt_s, 0.02), 2.0) ** 2


def merged_surface(clouds: Sequence[DeskewedScan], frame_T_body: Sequence[FloatArray]) -> cells.CellTable:
    """Search structure over the averaged surface of several scans, in their common frame."""
    raw = icp.reference_table(stacked(clouds, frame_T_body)[0])
    return icp.reference_table(cells.smooth_surface(raw, icp.CELL_M, SMOOTHING_M, SURFACE_SPACING_M))


def stacked(
    clouds: Sequence[DeskewedScan], frame_T_body: Sequence[FloatArray]
) -> tuple[FloatArray, IntArray]:
    """Oriented points (M, 4) of several scans in one frame, and the first row of each scan (N + 1,)."""
    first = np.cumsum([0, *(cloud.points_m.shape[0] for cloud in clouds)], dtype=np.int64)
    oriented = np.empty((int(first[-1]), 4))
    for n, (cloud, pose) in enumerate(zip(clouds, frame_T_body, strict=True)):
        poses.transform_points(pose, cloud.points_m, cloud.normals, oriented[first[n] : first[n + 1]])
    return oriented, first
