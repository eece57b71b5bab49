"""The second pass, from the optimised trajectory: keyframes adjusted together with the walls that they saw, then the
scans between them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from mfslam import icp, se2
from mfslam.adjustment import Adjusted, AdjustedInformation, Noise, ScanPoints, WheelTerms, adjust
from mfslam.config import Config, IcpConfig
from mfslam.deskew import deskew
from mfslam.observability import is_torn
from mfslam.scan_motion import ADJUSTED_SIGMAS, MATCHED_SIGMAS
from mfslam.step_records import Keyframe
from mfslam.surfaces import merged_surface, placed
from mfslam.types import Edge, FloatArray, IntArray, Match, Scan
from mfslam.wheel_errors import WheelErrors, WheelStep

# how well a scan between keyframes is known before (m, m, rad)
LOCALISE_SIGMAS = np.array([0.05, 0.05, 0.02])
# the surroundings of a keyframe: so many before it, so far off at most
SUCCESSIVE, AROUND_M = 3, 3.0
ASKED = 1000  # keyframes at a time
STRETCH = 3  # steps between keyframes whose scans are matched with one surface
PLACED = 256  # keyframes whose points are remembered in the world: the way goes on beside those that were just asked for
# of a step that wheels tell, or that nothing but inertia holds, where no wall does (1 m, 1 rad; 0.2 m, 0.2 rad)
HARDLY_ANYTHING, INERTIA = np.eye(3), 25.0 * np.eye(3)
LEAST_UNSEEN = 0.05**2  # nor does inertia know a step better
MOST_UNSEEN = 25.0  # variance of a step that nothing but inertia tells, so that no chain breaks


class Refinement:
    """Rounds of adjustment, each with keyframes deskewed anew; what one learns of the noise serves the next.

    ``edges``: of the solved graph. Loops that it refused (weight below one half) stay out; the others hold places
    together that share too little for their walls to do so.
    """

    def __init__(
        self, config: Config, edges: Sequence[Edge], steps: Sequence[tuple[int, int, WheelStep]],
        errors: WheelErrors, range_sigma_m: float,
    ) -> None:  # fmt: skip
        self.config = config
        self._adjusted: Adjusted | None = None
        self._range_sigma_m = range_sigma_m
        self.noise = Noise(range_sigma_m, config.icp.sigma_floor_m)
        self.wheels = WheelTerms(steps, errors.errors, errors.noise_share, config.odometry)
        told = set(zip(self.wheels.i.tolist(), self.wheels.j.tolist(), strict=True))
        self._ties = [
            _tie(edge, (edge.i, edge.j) in told) for edge in edges if edge.kind in ("scan", "ends", "heading")
        ]
        self._gate_share, self._iterations = 1.0, config.refine.iterations
        self._loops = [edge for edge in edges if edge.kind == "loop" and edge.weight >= 0.5]

    def forget(self) -> None:
        """Give back the system of the last round, which is large."""
        self._adjusted = None

    def round(self, points: ScanPoints, world_T_body: FloatArray) -> FloatArray:
        """(K, 3) keyframes after one more round."""
        gate_m = self.config.refine.search_radius_m * self._gate_share
        adjusted = adjust(
            points, world_T_body, [*self._ties, *self._loops], self.wheels, self.noise,
            self._iterations, gate_m,
        )  # fmt: skip
        self.noise, self._adjusted = adjusted.noise, adjusted
        self._gate_share, self._iterations = 0.5, max(1, self._iterations // 2)
        return adjusted.world_T_body

    def information(self) -> AdjustedInformation:
        """What the last round says of its own errors. No range is better than its sensor is said to be."""
        assert self._adjusted is not None
        scale = max(1.0, (self._range_sigma_m / self.noise.range_sigma_m) ** 2)
        return AdjustedInformation(self._adjusted.world_T_body, self._adjusted.solver, scale)


def held_by_inertia(information: FloatArray, unseen: FloatArray | None) -> FloatArray:
    """(3, 3) what a step between keyframes says that no wheels tell: its match, of ``information`` (3, 3), and inertia. ``unseen``
    (3, 3): covariance of the way on which no scan told it; where that is large, the match may have taken hold at the next
    place that looks alike."""
    if unseen is None:
        return information + INERTIA
    values, vectors = np.linalg.eigh(unseen)
    values = np.clip(values, 1.0 / INERTIA[0, 0], MOST_UNSEEN)
    held: FloatArray = information + vectors / values @ vectors.T
    if not is_torn(unseen):
        return held
    return np.asarray(np.linalg.inv(np.linalg.inv(held) + vectors * values @ vectors.T))


def likely_by_inertia(unseen: FloatArray) -> FloatArray:
    """(3, 3) what inertia says of where the robot likely is after a step, whose way no scan told with covariance ``unseen`` (3, 3)."""
    values, vectors = np.linalg.eigh(unseen)
    information: FloatArray = vectors / np.clip(values, LEAST_UNSEEN, 1.0 / INERTIA[0, 0]) @ vectors.T
    return information


def _tie(edge: Edge, told: bool) -> Edge:
    """An edge as the adjustment takes it: of a scan match only what it must say so that nothing falls apart."""
    if edge.kind != "scan":
        return edge
    most = HARDLY_ANYTHING if told else INERTIA
    if np.all(np.linalg.eigvalsh(edge.information - most) > 0.0):
        return replace(edge, information=most)
    values, vectors = np.linalg.eigh(edge.information)
    # less than hardly anything, and the system is too ill for single precision
    values = np.clip(values, HARDLY_ANYTHING[0, 0], most[0, 0])
    return replace(edge, information=vectors * values @ vectors.T)


def localise_between(
    scans: Sequence[Scan],
    twists: FloatArray,
    world_T_body: FloatArray,
    keyframes: Sequence[Keyframe],
    config: Config,
) -> tuple[FloatArray, FloatArray]:
    """(S, 3) poses in which the scans between keyframes were matched with the surface of keyframes around them;
    keyframes stay where they are. And sigmas (S, 3) of poses, in their tangents.

    ``world_T_body`` (S, 3) where every scan stands so far, at its reference instant.
    """
    out = world_T_body.copy()
    index: IntArray = np.array([k.scan_index for k in keyframes], dtype=np.int64)
    around = _around(world_T_body[index], config.refine.other_passes)

    @lru_cache(PLACED)
    def in_world(k: int) -> FloatArray:
        return placed(keyframes[k].cloud, world_T_body[index[k]])

    found: list[int] = []
    matches: list[Match] = []
    for a in range(0, len(keyframes) - 1, STRETCH):
        b = min(a + STRETCH, len(keyframes) - 1)
        waiting = [n for k in range(a, b) for n in range(index[k] + 1, index[k + 1])]
        if not waiting:
            continue
        # those inside the stretch know its ends, too
        members = set[int]().union(*(around[k] for k in range(a + 1, b) or (a, b)))
        surface = merged_surface([in_world(k) for k in sorted(members)])
        for n in waiting:
            scan, guess = scans[n], world_T_body[n]
            cloud = deskew(scan, twists[n], config.deskew, config.icp.point_spacing_m, doubtful=True)
            match = icp.register(
                surface, cloud.points_m, cloud.normals, guess, scan.laser.range_sigma_m, config.icp, guess,
                LOCALISE_SIGMAS, config.refine.search_radius_m,
            )  # fmt: skip
            if match.inlier_ratio >= config.refine.min_inlier_ratio:
                found.append(n)
                matches.append(match)
    sigmas = np.tile(MATCHED_SIGMAS, (len(scans), 1))
    if found:
        poses = np.array([match.ref_T_src for match in matches])
        near = np.all(np.abs(se2.between(world_T_body[found], poses)) < 3.0 * LOCALISE_SIGMAS, axis=1)
        rows = np.array(found)[near]
        out[rows] = poses[near]
        sigmas[rows] = _sigmas_of(np.array([match.information for match in matches])[near], config.icp)
    return out, sigmas


def _sigmas_of(information: FloatArray, config: IcpConfig) -> FloatArray:
    """(N, 3) of matches with a surface that is as good as known: all their beams count, and no drift of a recent map."""
    floor = np.array([config.sigma_floor_m, config.sigma_floor_m, config.sigma_floor_rad])
    covariances = np.linalg.inv(information + np.diag(LOCALISE_SIGMAS**-2.0))
    variances = np.diagonal(covariances, axis1=1, axis2=2)
    own = config.independent_share * np.maximum(variances - floor**2, 0.0)
    return np.asarray(np.sqrt(own + ADJUSTED_SIGMAS**2))


def _near(tree: Any, points_m: FloatArray) -> Iterator[list[int]]:
    """Of each point those of the tree within AROUND_M. Some points at a time: where a log passes a spot again and again, the
    lists of all take gigabytes."""
    for first in range(0, len(points_m), ASKED):
        yield from tree.query_ball_point(points_m[first : first + ASKED], AROUND_M)


def _around(world_T_body: FloatArray, most_others: int) -> list[set[int]]:
    """Of each keyframe those whose surface its surroundings are known by: the last few, and the nearest of so many
    other passes by the same spot; and those for which it is one itself."""
    from scipy.spatial import cKDTree

    tree = cKDTree(world_T_body[:, :2])
    around: list[set[int]] = [{k} for k in range(len(world_T_body))]
    for j, near in enumerate(_near(tree, world_T_body[:, :2])):
        others = np.array([i for i in near if i < j - SUCCESSIVE], dtype=np.int64)
        for i in [
            *range(max(0, j - SUCCESSIVE), j),
            *(_spread(world_T_body, j, others, most_others) if others.size else []),
        ]:
            around[j].add(i)
            around[i].add(j)
    return around


def _spread(world_T_body: FloatArray, j: int, candidates: IntArray, most: int) -> list[int]:
    """The nearest candidates, at most one of any ten successive keyframes; those that look the same way
    come first."""
    offset = world_T_body[candidates] - world_T_body[j]
    cost = np.hypot(offset[:, 0], offset[:, 1]) + 0.5 * np.abs(np.sin(0.5 * offset[:, 2]))
    chosen: list[int] = []
    left = candidates[np.argsort(cost)]
    while left.size and len(chosen) < most:
        chosen.append(int(left[0]))
        left = left[np.abs(left - left[0]) >= 10]
    return chosen
