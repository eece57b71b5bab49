"""Panes of glass: found among what too few beams met to be a wall."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from mfslam.kernels import glass
from mfslam.mapping.beams import ScanGroup, ahead
from mfslam.mapping.surface import PATCH_M, Surface
from mfslam.types import BoolArray, FloatArray, IntArray

_FAR_M = 8.0  # beams from farther away are too broad to be square
_MIN_HITS = 3.0  # around a patch, to be worth a look
_MIN_SQUARE = 2  # scans that met it squarely
_MET_SHARE = 0.5  # of the beams that came squarely
_MIN_LENGTH_M = 0.4  # people are narrower
_MAX_BEHIND = 0.2  # hits close behind it, of those on it: people are round


def find_panes(
    surface: Surface,
    groups: Iterable[ScanGroup],
    occupied: BoolArray,
    origin_m: FloatArray,
    resolution_m: float,
) -> FloatArray:
    """Lines (K, 5) of the patches of glass: those that are no wall yet (``occupied`` (rows, cols)), that most beams met that
    came squarely, with nothing close behind, in a straight row with others."""
    lines = surface.lines
    candidates = np.flatnonzero(lines[:, 4] >= _MIN_HITS)
    candidates = candidates[~_in_wall(lines[candidates, :2], occupied, origin_m, resolution_m)]
    met, passed = _count_square(lines[candidates], groups, surface.sigma_m)
    glassy = np.zeros(len(lines), np.bool_)
    glassy[candidates] = (met >= _MIN_SQUARE) & (met >= _MET_SHARE * (met + passed))
    index = np.flatnonzero(glassy)
    behind = glass.share_behind(surface.keys, surface.sums, lines[index], PATCH_M, surface.sigma_m)
    glassy[index] = behind <= _MAX_BEHIND
    least = round(_MIN_LENGTH_M / PATCH_M)
    kept = glass.keep_runs(surface.keys, lines, glassy, PATCH_M, surface.sigma_m, least)
    panes: FloatArray = lines[kept]
    return panes


def _in_wall(
    points_m: FloatArray, occupied: BoolArray, origin_m: FloatArray, resolution_m: float
) -> BoolArray:
    """Whether each point (K, 2) lies in an occupied cell."""
    rows, cols = occupied.shape
    col, row = np.floor((points_m - origin_m) / resolution_m).astype(np.int64).T
    inside: BoolArray = occupied[np.clip(row, 0, rows - 1), np.clip(col, 0, cols - 1)]
    return inside


def _count_square(
    lines: FloatArray, groups: Iterable[ScanGroup], sigma_m: float
) -> tuple[IntArray, IntArray]:
    """Scans that met each patch squarely, and scans that passed it so."""
    met, passed = np.zeros(len(lines), np.int64), np.zeros(len(lines), np.int64)

    def count(group: ScanGroup) -> tuple[IntArray, IntArray, IntArray]:
        """Patches near the group, and how many of its scans met and passed each."""
        low, high = group.world_T_body[:, :2].min(axis=0), group.world_T_body[:, :2].max(axis=0)
        near = np.all((lines[:, :2] > low - _FAR_M) & (lines[:, :2] < high + _FAR_M), axis=1)
        laser = group.laser
        index = np.flatnonzero(near) if laser.angles_rad.size > 1 else np.zeros(0, np.int64)
        more_met, more_passed = np.zeros(len(index), np.int64), np.zeros(len(index), np.int64)
        if not len(index):
            return index, more_met, more_passed
        order = np.argsort(laser.angles_rad, kind="stable")
        in_order = bool(np.all(order[1:] > order[:-1]))
        glass.count_square(
            lines[index], group.ranges_m if in_order else np.ascontiguousarray(group.ranges_m[:, order]),
            group.world_T_body, group.twists, laser.angles_rad[order], group.times_s[order], laser.body_T_laser,
            (laser.range_min_m, laser.range_max_m, _FAR_M), sigma_m, more_met, more_passed,
        )  # fmt: skip
        return index, more_met, more_passed

    for index, more_met, more_passed in ahead(groups, count, threads=2):
        met[index] += more_met
        passed[index] += more_passed
    return met, passed
