"""The second pass: scans matched again with all that overlap them, from the optimised trajectory."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import replace
from typing import cast

import numpy as np

from mfslam import icp, se2
from mfslam.config import Config, IcpConfig, RefineConfig
from mfslam.deskew import deskew
from mfslam.frontend import Keyframe, merged_surface
from mfslam.kernels import poses
from mfslam.kernels.cells import CellTable
from mfslam.types import DeskewedScan, Edge, FloatArray, IntArray, Scan

MAX_TABLES = 500
LOCALISE_SIGMAS = np.array(
    [0.05, 0.05, 0.02]
)  # how well a scan between keyframes is known before (m, m, rad)


def neighbours(world_T_body: FloatArray, config: RefineConfig) -> list[tuple[int, int]]:
    """Pairs (i, j), i < j, of keyframes to match: the last few, and of every other pass by the same spot
    the nearest ones."""
    from scipy.spatial import cKDTree

    tree = cKDTree(world_T_body[:, :2])
    nearby = cast(Sequence[list[int]], tree.query_ball_point(world_T_body[:, :2], config.radius_m))
    pairs: list[tuple[int, int]] = []
    for j, near in enumerate(nearby):
        for i in range(max(0, j - config.successive), j):
            pairs.append((i, j))
        others = np.array([i for i in near if i < j - config.successive], dtype=np.int64)
        if others.size and config.others:
            pairs += [(i, j) for i in _spread(world_T_body, j, others, config.others)]
    return pairs


def _spread(world_T_body: FloatArray, j: int, candidates: IntArray, count: int) -> list[int]:
    """The nearest candidates, at most one of any ten successive keyframes; those that look the same way
    come first."""
    offset = world_T_body[candidates] - world_T_body[j]
    cost = np.hypot(offset[:, 0], offset[:, 1]) + 0.5 * np.abs(np.sin(0.5 * offset[:, 2]))
    chosen: list[int] = []
    left = candidates[np.argsort(cost)]
    while left.size and len(chosen) < count:
        chosen.append(int(left[0]))
        left = left[np.abs(left - left[0]) >= 10]
    return chosen


def match_neighbours(
    clouds: list[DeskewedScan],
    world_T_body: FloatArray,
    pairs: list[tuple[int, int]],
    range_sigma_m: float,
    icp_config: IcpConfig,
    config: RefineConfig,
) -> list[Edge]:
    """Pairwise edges of overlapping scans, each from the current estimate and close to it.

    The reference of a predecessor is the surface that it and those before it saw
    (``config.surface_keyframes``), that of another pass the scan alone.
    """
    own = ("independent_share", "sigma_floor_m", "sigma_floor_deg")
    icp_config = icp_config.model_copy(update={key: getattr(config, key) for key in own})
    tables: OrderedDict[tuple[int, int], CellTable] = OrderedDict()  # of the latest references
    edges: list[Edge] = []
    for i, j in pairs:  # they come in order of j
        merged = config.surface_keyframes if j - i <= config.successive else 1
        key = (i, merged)
        if key not in tables:
            tables[key] = _reference(clouds, world_T_body, range(max(0, i - merged + 1), i + 1))
            if len(tables) > MAX_TABLES:
                tables.popitem(last=False)
        tables.move_to_end(key)
        guess = poses.between(world_T_body[i], world_T_body[j])
        match = icp.register(
            tables[key], clouds[j].points_m, clouds[j].normals, guess, range_sigma_m, icp_config,
            search_radius_m=config.search_radius_m,
        )  # fmt: skip
        if match.inlier_ratio < config.min_inlier_ratio or not match.converged:
            continue
        moved = poses.between(guess, match.ref_T_src)
        if math.hypot(moved[0], moved[1]) > config.search_radius_m or abs(moved[2]) > 0.1:
            continue
        edges.append(Edge("scan", i, j, match.ref_T_src, match.information))
    return edges


def with_motion_errors(edges: list[Edge], variances: FloatArray) -> list[Edge]:
    """Scan edges less sure by what the motion within either scan may have moved it: ``variances`` (K, 3) of each
    keyframe's pose in its own frame."""
    out = []
    for edge in edges:
        adjoint = se2.adjoint(poses.between(edge.i_T_j, np.zeros(3)))
        error = adjoint * variances[edge.i] @ adjoint.T + np.diag(variances[edge.j])
        # (H^-1 + F)^-1 without inverting what may be singular
        information = edge.information @ np.linalg.inv(np.eye(3) + error @ edge.information)
        out.append(replace(edge, information=0.5 * (information + information.T)))
    return out


def with_shared_noise(edges: list[Edge]) -> list[Edge]:
    """Scan edges that know how many tell of the same noise.

    The noise of one scan enters every edge that it is part of, and moves its pose as one. A graph that takes E edges
    between K poses as independent says that the mean edge is known E / (K - 1) times as well as it is (the sum of
    what is left of every edge's variance is K - 1 times its own: Foster 1949). So each edge counts as one of half
    the edges that meet at its ends, on average.
    """
    if not edges:
        return []
    ends = np.array([(edge.i, edge.j) for edge in edges])
    met = np.bincount(ends.ravel())
    return [replace(edge, shared=max(1.0, 0.25 * float(met[edge.i] + met[edge.j]))) for edge in edges]


def _reference(clouds: list[DeskewedScan], world_T_body: FloatArray, members: range) -> CellTable:
    """Search structure over what the keyframes ``members`` saw, in the frame of the last of them."""
    last = members[-1]
    if len(members) == 1:
        return icp.reference_table(np.hstack([clouds[last].points_m, clouds[last].normals]))
    last_T_members = [poses.between(world_T_body[last], world_T_body[k]) for k in members]
    return merged_surface([clouds[k] for k in members], last_T_members)


def localise_between(
    scans: Sequence[Scan],
    twists: FloatArray,
    world_T_body: FloatArray,
    keyframes: Sequence[Keyframe],
    pairs: list[tuple[int, int]],
    config: Config,
) -> FloatArray:
    """(S, 3) poses in which the scans between keyframes were matched with the surface of all keyframes
    around them; keyframes stay where they are.

    ``world_T_body`` (S, 3) where every scan stands so far, at its reference instant.
    """
    around: list[set[int]] = [{k} for k in range(len(keyframes))]
    for i, j in pairs:
        around[j].add(i)
        around[i].add(j)
    out = world_T_body.copy()
    loose = np.diag(LOCALISE_SIGMAS**-2.0)
    icp_config, spacing_m = config.icp, config.icp.point_spacing_m
    for a in range(len(keyframes) - 1):
        first, last = keyframes[a].scan_index + 1, keyframes[a + 1].scan_index
        if first >= last:
            continue
        members = sorted(around[a] | around[a + 1])
        surface = merged_surface(
            [keyframes[k].cloud for k in members], [world_T_body[keyframes[k].scan_index] for k in members]
        )
        for n in range(first, last):
            cloud = deskew(scans[n], twists[n], config.deskew, spacing_m)
            guess = world_T_body[n]
            match = icp.register(
                surface, cloud.points_m, cloud.normals, guess, scans[n].laser.range_sigma_m, icp_config,
                guess, loose, config.refine.search_radius_m,
            )  # fmt: skip
            moved = poses.between(guess, match.ref_T_src)
            if match.inlier_ratio >= config.refine.min_inlier_ratio and np.all(
                np.abs(moved) < LOCALISE_SIGMAS * 3.0
            ):
                out[n] = match.ref_T_src
    return out
