"""Edges of a pose graph as arrays that grow with it."""

from __future__ import annotations

from collections.abc import Iterable
from copy import copy

import numpy as np

from mfslam import se2
from mfslam.types import BoolArray, Edge, FloatArray, IntArray


class EdgeArrays:
    """Ends (E, 2), measured motions (E, 3), their information (E, 3, 3), and which are loops or scan matches (E,)."""

    def __init__(self, edges: Iterable[Edge] = ()) -> None:
        self._count = 0
        self._ends = np.empty((16, 2), np.int64)
        self._measured = np.empty((16, 3))
        self._information = np.empty((16, 3, 3))
        self._kinds = np.empty((16, 2), np.bool_)
        for edge in edges:
            self.append(edge)

    def __len__(self) -> int:
        return self._count

    def append(self, edge: Edge) -> None:
        n = self._count
        if n == len(self._ends):
            for name in ("_ends", "_measured", "_information", "_kinds"):
                array = getattr(self, name)
                setattr(self, name, np.concatenate([array, np.empty_like(array)]))
        self._ends[n] = edge.i, edge.j
        self._measured[n], self._information[n] = edge.i_T_j, edge.information
        self._kinds[n] = edge.kind == "loop", edge.kind in ("loop", "scan")
        self._count = n + 1

    def are_off(self, numbers: IntArray, poses: FloatArray, most_m: float, most_rad: float) -> BoolArray:
        """Which of the edges numbered poses (K, 3) miss by more."""
        i, j = self.ends[numbers].T
        error = se2.between(self.measured[numbers], se2.between(poses[i], poses[j]))
        return np.asarray((np.hypot(error[:, 0], error[:, 1]) > most_m) | (np.abs(error[:, 2]) > most_rad))

    def restated(self, numbers: IntArray, poses: FloatArray) -> EdgeArrays:
        """The same edges, of which those numbered measure what ``poses`` (K, 3) say; compass readings stay."""
        out = copy(self)
        out._measured = self._measured.copy()
        between = numbers[self.ends[numbers, 0] != self.ends[numbers, 1]]
        out._measured[between] = se2.between(*poses[self.ends[between].T])
        return out

    def since(self, number: int) -> EdgeArrays:
        """The edges from that number on."""
        out = copy(self)
        for name in ("_ends", "_measured", "_information", "_kinds"):
            setattr(out, name, getattr(self, name)[number:])
        out._count = self._count - number
        return out

    @property
    def ends(self) -> IntArray:
        return self._ends[: self._count]

    @property
    def measured(self) -> FloatArray:
        return self._measured[: self._count]

    @property
    def information(self) -> FloatArray:
        return self._information[: self._count]

    @property
    def is_loop(self) -> BoolArray:
        return self._kinds[: self._count, 0]

    @property
    def is_match(self) -> BoolArray:
        """Loops and scan matches."""
        return self._kinds[: self._count, 1]
