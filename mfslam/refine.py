"""The second pass: scans matched again with all that overlap them, from the optimised trajectory."""

from __future__ import annotations

import math

import numpy as np

from mfslam import icp
from mfslam.config import IcpConfig, RefineConfig
from mfslam.kernels import poses
from mfslam.kernels.cells import CellTable
from mfslam.types import DeskewedScan, Edge, FloatArray, IntArray


def neighbours(world_T_body: FloatArray, config: RefineConfig) -> list[tuple[int, int]]:
    """Pairs (i, j), i < j, of keyframes to match: the last few, and of every other pass by the same spot
    the nearest ones."""
    from scipy.spatial import cKDTree

    tree = cKDTree(world_T_body[:, :2])
    pairs: list[tuple[int, int]] = []
    for j, near in enumerate(tree.query_ball_point(world_T_body[:, :2], config.radius_m)):
        for i in range(max(0, j - config.successive), j):
            pairs.append((i, j))
        others = np.array([i for i in near if i < j - config.successive], dtype=np.int64)
        if others.size:
            pairs += [(i, j) for i in _spread(world_T_body, j, others, config.others)]
    return pairs


def _spread(world_T_body: FloatArray, j: int, candidates: IntArray, count: int) -> list[int]:
    """The nearest candidates, at most one of any ten successive keyframes; those that look the same way
    come first."""
    offset = world_T_body[candidates] - world_T_body[j]
    cost = np.hypot(offset[:, 0], offset[:, 1]) + 0.5 * np.abs(np.sin(0.5 * offset[:, 2]))
    chosen: list[int] = []
    for k in candidates[np.argsort(cost)]:
        if all(abs(k - c) >= 10 for c in chosen):
            chosen.append(int(k))
            if len(chosen) == count:
                break
    return chosen


def match_neighbours(
    clouds: list[DeskewedScan],
    world_T_body: FloatArray,
    pairs: list[tuple[int, int]],
    range_sigma_m: float,
    icp_config: IcpConfig,
    config: RefineConfig,
) -> list[Edge]:
    """Pairwise edges of overlapping scans, each from the current estimate and close to it."""
    tables: dict[int, CellTable] = {}
    edges: list[Edge] = []
    for i, j in pairs:
        if i not in tables:
            tables[i] = icp.reference_table(np.hstack([clouds[i].points_m, clouds[i].normals]))
        guess = poses.between(world_T_body[i], world_T_body[j])
        match = icp.register(
            tables[i], clouds[j].points_m, clouds[j].normals, guess, range_sigma_m, icp_config,
            search_radius_m=config.search_radius_m,
        )  # fmt: skip
        if match.inlier_ratio < config.min_inlier_ratio or not match.converged:
            continue
        moved = poses.between(guess, match.ref_T_src)
        if math.hypot(moved[0], moved[1]) > config.search_radius_m or abs(moved[2]) > 0.1:
            continue
        edges.append(Edge("scan", i, j, match.ref_T_src, match.information))
    return edges
