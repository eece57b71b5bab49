"""Scan after scan: predict, deskew, match against the recent past, choose keyframes."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np

from mfslam import icp
from mfslam.config import Config
from mfslam.deskew import deskew
from mfslam.kernels import cells, poses
from mfslam.odometry import step_sigmas
from mfslam.search import SearchMap, search
from mfslam.types import DeskewedScan, FloatArray, Match, Scan


SURPRISE_GATE = 3.0  # sigmas
MATCH_SIGMAS = np.array([0.01, 0.01, 0.005])  # of one match, beside those of the wheels (m, m, rad)


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

    def process(self, index: int, scan: Scan, wheel_step: FloatArray | None, twist: FloatArray) -> Step:
        """``wheel_step`` (3,): wheel motion since the previous scan, None when there are no wheels."""
        config = self.config
        cloud = deskew(scan, twist, config.deskew, config.icp.point_spacing_m)
        if self.reference is None:
            self._add_keyframe(index, cloud)
            return Step(self.local_T_body, None, True)
        predicted_step = self.last_step if wheel_step is None else wheel_step
        guess = poses.compose(self.local_T_body, predicted_step)
        self.wheels_since_keyframe = poses.compose(self.wheels_since_keyframe, predicted_step)
        match = self._match(scan, cloud, guess, with_wheels=self.wheels_trusted)
        step = poses.between(self.local_T_body, match.ref_T_src)
        surprise = self._surprise(predicted_step, step)
        searched = False
        if match.inlier_ratio < config.frontend.min_inlier_ratio or surprise > SURPRISE_GATE:
            better = self._search(scan, cloud, guess, match)
            if better is not None:
                match, searched = better, True
                step = poses.between(self.local_T_body, match.ref_T_src)
                surprise = self._surprise(predicted_step, step)
        jump = wheel_step is not None and surprise > SURPRISE_GATE
        if jump:
            self.wheels_trusted = False
        self.local_T_body, self.last_step = match.ref_T_src, step
        moved = poses.between(self.recent[-1].local_T_body, self.local_T_body)
        is_keyframe = (
            math.hypot(moved[0], moved[1]) >= config.frontend.keyframe_distance_m
            or abs(moved[2]) >= math.radians(config.frontend.keyframe_angle_deg)
        )
        if is_keyframe:
            self._add_keyframe(index, cloud)
        return Step(self.local_T_body, match, is_keyframe, searched, jump)

    def _surprise(self, predicted_step: FloatArray, step: FloatArray) -> float:
        """How far a step lies from its prediction, in sigmas of the worst direction."""
        error = poses.between(predicted_step, step)
        sigmas = 2.0 * step_sigmas(predicted_step, self.config.odometry) + MATCH_SIGMAS
        return float(np.max(np.abs(error) / sigmas))

    def _match(self, scan: Scan, cloud: DeskewedScan, guess: FloatArray, with_wheels: bool) -> Match:
        """ICP from ``guess``; the wheels' motion since the keyframe holds what the scan leaves open."""
        assert self.reference is not None
        prior = prior_information = None
        if with_wheels:
            prior = poses.compose(self.recent[-1].local_T_body, self.wheels_since_keyframe)
            prior_information = np.diag(
                1.0 / step_sigmas(self.wheels_since_keyframe, self.config.odometry) ** 2
            )
        return icp.register(
            self.reference, cloud.points_m, cloud.normals, guess, scan.laser.range_sigma_m,
            self.config.icp, prior, prior_information,
        )  # fmt: skip

    def _search(self, scan: Scan, cloud: DeskewedScan, guess: FloatArray, match: Match) -> Match | None:
        """A clearly better fit than ``match`` near ``guess``, by correlative search over the recent map and
        ICP from there; None when there is none."""
        assert self.reference is not None
        config = self.config.frontend
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
                better = self._match(scan, cloud, found, with_wheels=False)
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
        self.reference = merged_surface(list(self.recent))
        self.place = None


def merged_surface(keyframes: list[Keyframe]) -> cells.CellTable:
    """Search structure over the averaged surface of several keyframes, in their common frame."""
    oriented = np.empty((sum(k.cloud.points_m.shape[0] for k in keyframes), 4))
    at = 0
    for k in keyframes:
        n = k.cloud.points_m.shape[0]
        poses.transform_points(k.local_T_body, k.cloud.points_m, k.cloud.normals, oriented[at : at + n])
        at += n
    raw = icp.reference_table(oriented)
    surface = cells.smooth_surface(raw, icp.CELL_M, 0.1, 0.04)
    return icp.reference_table(surface)
