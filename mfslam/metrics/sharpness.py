"""What deskewing makes of the map: the same hits, from the same poses, with different motions through the scans."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mfslam.config import Config
from mfslam.kernels import raytrace
from mfslam.mapping.beams import scan_groups
from mfslam.mapping.surface import Surface
from mfslam.metrics.crispness import Crispness, crispness
from mfslam.types import BoolArray, FloatArray, IntArray, Scan

MAX_BEAMS = 400_000  # of more, every second, third, ... scan is taken
CELL_M = 0.02
PATCH_M = 0.4  # a piece of wall
_MIN_HITS, _MIN_SCANS = 30, 5  # of a piece of wall
_MIN_SPREAD_M = 0.06  # along the wall: half of what a full piece has


@dataclass(frozen=True, slots=True)
class Sharpness:
    """Of hits: crispness over cells, and thickness of ``planes`` pieces of wall.

    The thickness of a piece is the root mean square of its hits' distances from their own best line; median and mean are over
    the pieces. A piece is what lies in one square of `PATCH_M` and faces about the same way, seen by `_MIN_SCANS` scans
    or more with `_MIN_HITS` hits or more.
    """

    crispness: Crispness
    planes: int
    thickness_median_m: float
    thickness_mean_m: float

    def as_json(self) -> dict[str, Any]:
        return {
            "cells": self.crispness.cells,
            "entropy_bits": self.crispness.entropy_bits,
            "plane_thickness_median_m": self.thickness_median_m,
            "plane_thickness_mean_m": self.thickness_mean_m,
        }


def compare_motions(
    scans: Sequence[Scan],
    world_T_body: FloatArray,
    motions: Mapping[str, FloatArray],
    config: Config,
) -> dict[str, Any]:
    """`Sharpness` as JSON by the name of each of ``motions``: twists (S, 3) or (S, 6) through all scans, from the same poses (S, 3) at the
    scans' reference instants. Empty without any hit.

    Which hits make up a piece of wall is found with the last of the motions, and is the same for all. Only so many scans
    are taken, evenly over the log, as have `MAX_BEAMS` beams.
    """
    beams = sum(scan.ranges_m.size for scan in scans)
    chosen = np.arange(0, len(scans), max(1, -(-beams // MAX_BEAMS)))
    some = [scans[n] for n in chosen.tolist()]
    as_posed = config.model_copy(update={"deskew": config.deskew.model_copy(update={"mode": "pose"})})
    *_, last = motions.values()
    reference, facings, scan_of = _oriented_hits(some, world_T_body[chosen], last[chosen], as_posed)
    if not len(reference):
        return {}
    pieces = _Pieces.of(reference, facings, scan_of)
    return {
        name: _sharpness(
            reference if twists is last else _hits(some, world_T_body[chosen], twists[chosen], as_posed),
            pieces,
        ).as_json()
        for name, twists in motions.items()
    }


def _hits(scans: Sequence[Scan], world_T_body: FloatArray, twists: FloatArray, config: Config) -> FloatArray:
    """All hits (P, 2)."""
    beams = [group.place() for group in scan_groups(scans, world_T_body, twists, config)]
    return np.concatenate([each.ends_m[each.kinds == raytrace.HIT] for each in beams])


def _oriented_hits(
    scans: Sequence[Scan], world_T_body: FloatArray, twists: FloatArray, config: Config
) -> tuple[FloatArray, IntArray, IntArray]:
    """All hits (P, 2), the sector that each faces (P,), and its scan (P,)."""
    surface, points, scan_of, first = Surface(), [np.zeros((0, 2))], [np.zeros(0, np.int64)], 0
    facings = [np.zeros(0, np.int64)]
    for group in scan_groups(scans, world_T_body, twists, config):
        beams = group.place()
        surface.add(beams)
        met = beams.kinds == raytrace.HIT
        points.append(beams.ends_m[met])
        facings.append(surface.facings.pop()[met].astype(np.int64))
        scan_of.append(first + np.nonzero(met)[0])
        first += len(beams.kinds)
    return np.concatenate(points), np.concatenate(facings), np.concatenate(scan_of)


@dataclass(frozen=True, eq=False)
class _Pieces:
    """Pieces of wall: the hits that belong to one, and the number (from 0) of each one's piece."""

    hits: IntArray
    piece: IntArray
    count: int

    @classmethod
    def of(cls, points_m: FloatArray, facings: IntArray, scan_of: IntArray) -> _Pieces:
        """Of hits (P, 2), their sectors (P,), -1 for none, and their scans (P,), which never fall."""
        oriented = np.flatnonzero(facings >= 0)
        square = np.floor(points_m[oriented] / PATCH_M).astype(np.int64)
        for axis in range(2):
            square[:, axis] -= square[:, axis].min(initial=0)
        key = (square[:, 0] * (int(square[:, 1].max(initial=0)) + 1) + square[:, 1]) * 8 + facings[oriented]
        by_piece = np.argsort(key, kind="stable")  # within a piece in the order of the scans
        key, scan = key[by_piece], scan_of[oriented][by_piece]
        begins = _changes(key)
        piece = np.cumsum(begins) - 1
        hits = np.bincount(piece)
        seen_by = np.bincount(piece[begins | _changes(scan)])
        good = (hits >= _MIN_HITS) & (seen_by >= _MIN_SCANS)
        kept = good[piece]
        renumbered = np.cumsum(good) - 1
        return cls(oriented[by_piece[kept]], renumbered[piece[kept]], int(np.count_nonzero(good)))


def _changes(values: IntArray) -> BoolArray:
    """(P,) whether each value is another than the one before; the first is."""
    out = np.ones(len(values), np.bool_)
    out[1:] = values[1:] != values[:-1]
    return out


def _sharpness(points_m: FloatArray, pieces: _Pieces) -> Sharpness:
    across, along = _spreads(points_m[pieces.hits], pieces.piece, pieces.count)
    thickness = across[along >= _MIN_SPREAD_M]
    none = not len(thickness)
    return Sharpness(
        crispness(points_m, CELL_M),
        len(thickness),
        float("nan") if none else float(np.median(thickness)),
        float("nan") if none else float(np.mean(thickness)),
    )


def _spreads(points_m: FloatArray, piece: IntArray, pieces: int) -> tuple[FloatArray, FloatArray]:
    """Root mean square distance of each piece's points from their best line, and along it, from their middle."""
    count = np.maximum(np.bincount(piece, minlength=pieces), 1)

    def mean(values: FloatArray) -> FloatArray:
        return np.asarray(np.bincount(piece, values, pieces) / count)

    dx, dy = points_m[:, 0] - mean(points_m[:, 0])[piece], points_m[:, 1] - mean(points_m[:, 1])[piece]
    xx, xy, yy = mean(dx * dx), mean(dx * dy), mean(dy * dy)
    root = np.sqrt((0.5 * (xx - yy)) ** 2 + xy * xy)
    return np.sqrt(np.maximum(0.5 * (xx + yy) - root, 0.0)), np.sqrt(0.5 * (xx + yy) + root)
