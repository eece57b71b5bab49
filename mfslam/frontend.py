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
from mfslam.types import DeskewedScan, FloatArray, Match, Scan


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
    recovered: bool = False
    odometry_jump: bool = False


@dataclass(eq=False)
class Frontend:
    """Keeps a locally consistent frame (``local``) that never jumps; the graph corrects it globally."""

    config: Config
    recent: deque[Keyframe] = field(default_factory=deque)
    local_T_body: FloatArray = field(default_factory=lambda: np.zeros(3))
    reference: cells.CellTable | None = None
    since_keyframe: FloatArray = field(default_factory=lambda: np.zeros(3))

    def process(self, index: int, scan: Scan, odom_step: FloatArray | None, twist: FloatArray) -> Step:
        """``odom_step`` (3,): wheel motion since the previous scan, None when there are no wheels."""
        config = self.config
        cloud = deskew(scan, twist, config.deskew, config.icp.point_spacing_m)
        if self.reference is None:
            self._add_keyframe(index, cloud)
            return Step(self.local_T_body, None, True)
        step = odom_step if odom_step is not None else np.zeros(3)
        guess = poses.compose(self.local_T_body, step)
        self.since_keyframe = poses.compose(self.since_keyframe, step)
        prior = poses.compose(self.recent[-1].local_T_body, self.since_keyframe)
        sigmas = step_sigmas(self.since_keyframe, config.odometry)
        match = icp.register(
            self.reference,
            cloud.points_m,
            cloud.normals,
            guess,
            scan.laser.range_sigma_m,
            config.icp,
            prior,
            np.diag(1.0 / sigmas**2),
        )
        self.local_T_body = match.ref_T_src
        moved = poses.between(self.recent[-1].local_T_body, self.local_T_body)
        is_keyframe = (
            math.hypot(moved[0], moved[1]) >= config.frontend.keyframe_distance_m
            or abs(moved[2]) >= math.radians(config.frontend.keyframe_angle_deg)
        )
        if is_keyframe:
            self._add_keyframe(index, cloud)
        return Step(self.local_T_body, match, is_keyframe)

    def _add_keyframe(self, index: int, cloud: DeskewedScan) -> None:
        self.recent.append(Keyframe(index, cloud, self.local_T_body))
        if len(self.recent) > self.config.frontend.local_keyframes:
            self.recent.popleft()
        self.since_keyframe = np.zeros(3)
        self.reference = merged_surface(list(self.recent))


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
