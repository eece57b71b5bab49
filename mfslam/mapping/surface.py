"""The surface that all scans agree on."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from mfslam.kernels import surfels
from mfslam.mapping.beams import Beams
from mfslam.types import FloatArray, Int8Array, IntArray

PATCH_M = 0.06  # of surface: small against what is curved, large enough to gather hits
_FIRST_SLOTS = 1 << 12
_ROUNDS = 3  # of moving patches to the mean around them


def _no_keys() -> IntArray:
    return np.full(_FIRST_SLOTS, surfels.EMPTY, np.int64)


@dataclass(eq=False)
class Surface:
    """Patches of what hits lie on, by place and by the direction that they face.

    First `add` all beams, then `fit`; `adjust` moves hits onto it, of the beams in the same order. ``sigma_m``: largest
    spread of the hits across it. ``lines`` (slots, 5): see `mfslam.kernels.surfels.fit_surfaces`.
    """

    keys: IntArray = field(default_factory=_no_keys)
    sums: FloatArray = field(default_factory=lambda: np.zeros((_FIRST_SLOTS, 5)))
    used: int = 0
    sigma_m: float = 0.0
    lines: FloatArray = field(default_factory=lambda: np.zeros((_FIRST_SLOTS, 5)))
    facings: list[Int8Array] = field(
        default_factory=list
    )  # of each beam, by group: -1, or the sector it faces

    @property
    def most_moved_m(self) -> float:
        """No hit is moved farther than this."""
        return surfels.MOST_SIGMAS * self.sigma_m

    def add(self, beams: Beams) -> None:
        """Gather the hits of these beams."""
        facings = np.empty(beams.kinds.shape, np.int8)
        self.sigma_m = max(self.sigma_m, beams.sigma_m)
        self.keys, self.sums, self.used = surfels.add_hits(
            self.keys, self.sums, self.used, beams.starts_m, beams.ends_m, beams.kinds, beams.step_rad,
            beams.sigma_m, PATCH_M, facings,
        )  # fmt: skip
        self.facings.append(facings)

    def fit(self) -> None:
        """Average: each patch with those around it."""
        used = np.flatnonzero(self.keys != surfels.EMPTY)
        column_by_column = used[np.argsort(self.keys[used])]
        self.lines = surfels.fit_surfaces(
            self.keys, self.sums, column_by_column, PATCH_M, self.sigma_m, _ROUNDS
        )

    def adjust(self, group: int, beams: Beams) -> None:
        """Move the hits of the beams that were added as number ``group`` onto the surface, within their noise."""
        surfels.adjust_ends(
            self.keys, self.lines, PATCH_M, beams.sigma_m, self.facings[group], beams.starts_m, beams.kinds,
            beams.ends_m,
        )  # fmt: skip
