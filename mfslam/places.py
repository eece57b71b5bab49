"""Places: the merged scans of a stretch of path, ready to be searched, matched and contradicted."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from mfslam import icp
from mfslam.kernels import cells, evidence, poses
from mfslam.kernels.cells import CellTable
from mfslam.search import SearchMap
from mfslam.step_records import Keyframe
from mfslam.surfaces import SMOOTHING_M, placed
from mfslam.types import FloatArray

CELL_M = 0.1
REACH_M = 15.0
SURFACE_SPACING_M = 0.06  # coarser than the front end's: places are many


@dataclass(frozen=True, eq=False)
class Place:
    """Scans of some keyframes in the frame of one of them (the anchor).

    ``surface`` (M, 4): averaged points with normals within reach. ``table``: the same, searchable.
    ``evidence``: states of the cells whose lower-left corner is ``corner_m``.
    """

    anchor: int
    surface: FloatArray
    table: CellTable
    evidence: npt.NDArray[np.uint8]
    corner_m: FloatArray

    @classmethod
    def of(cls, keyframes: list[Keyframe], members: range, anchor: int) -> Place:
        origin = keyframes[anchor].local_T_body
        anchor_T_body = [poses.between(origin, keyframes[k].local_T_body) for k in members]
        of_each = [placed(keyframes[k].cloud, pose) for k, pose in zip(members, anchor_T_body, strict=True)]
        oriented, first = np.concatenate(of_each), np.cumsum([0, *map(len, of_each)])
        eyes = np.array([pose[:2] for pose in anchor_T_body]).reshape(-1, 2)
        corner = np.full(2, -REACH_M)
        size = int(2 * REACH_M / CELL_M)
        grid = evidence.evidence_grid(
            eyes, first, np.ascontiguousarray(oriented[:, :2]), corner, size, size, CELL_M
        )
        near = (np.abs(oriented[:, 0]) < REACH_M) & (np.abs(oriented[:, 1]) < REACH_M)
        raw = icp.reference_table(oriented[near])
        surface = cells.smooth_surface(raw, icp.CELL_M, SMOOTHING_M, SURFACE_SPACING_M)
        return cls(anchor, surface, icp.reference_table(surface), grid, corner)

    @cached_property
    def points_m(self) -> FloatArray:
        """(M, 2)"""
        return np.ascontiguousarray(self.surface[:, :2])

    @cached_property
    def normals(self) -> FloatArray:
        """(M, 2)"""
        return np.ascontiguousarray(self.surface[:, 2:])

    @cached_property
    def fine_map(self) -> SearchMap:
        """For narrow windows."""
        return SearchMap.of(self.points_m, np.zeros(2), REACH_M, CELL_M)

    @cached_property
    def coarse_map(self) -> SearchMap:
        """For wide windows."""
        return SearchMap.of(self.points_m, np.zeros(2), REACH_M, 2 * CELL_M)

    def agreement(self, place_T_other: FloatArray, other: Place) -> tuple[float, float]:
        """Share of the other's points that are seen from both and not contradicted here, and share seen from both."""
        agree, contradict, count = evidence.agreement(
            self.evidence, self.corner_m, CELL_M, place_T_other, other.points_m
        )
        seen = agree + contradict
        return agree / max(1, seen), seen / max(1, count)


class PlaceMemory:
    """Places along the path, every half segment one, made when first asked for; the latest used stay."""

    def __init__(self, keyframes: list[Keyframe], capacity: int = 80) -> None:
        self._keyframes = keyframes
        self._capacity = capacity
        self._made: OrderedDict[tuple[int, int], Place] = OrderedDict()

    def at(self, members: range, anchor: int) -> Place:
        key = (members.start, members.stop)
        if key not in self._made:
            self._made[key] = Place.of(self._keyframes, members, anchor)
            if len(self._made) > self._capacity:
                self._made.popitem(last=False)
        self._made.move_to_end(key)
        return self._made[key]
