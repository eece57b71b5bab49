"""Error against distance travelled: how fast a trajectory goes astray (Geiger et al., KITTI, CVPR 2012)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mfslam import se2
from mfslam.types import FloatArray

LENGTHS_M = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0)
_STARTS = 2000  # at most, of each length


@dataclass(frozen=True, slots=True)
class Drift:
    """Mean error of the motion over stretches of ``length_m`` of the true path."""

    length_m: float
    stretches: int
    translation_m: float
    rotation_deg: float

    def as_json(self) -> dict[str, Any]:
        return {
            "length_m": self.length_m,
            "stretches": self.stretches,
            "translation_m": self.translation_m,
            "rotation_deg": self.rotation_deg,
        }


def drift(truth: FloatArray, estimate: FloatArray, lengths_m: tuple[float, ...] = LENGTHS_M) -> list[Drift]:
    """Over matched poses (N, 3) in the order of time; lengths that the path does not have are left out."""
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(truth[:, :2], axis=0).T))])
    out = []
    for length in lengths_m:
        ends = np.searchsorted(along, along + length)
        starts = np.flatnonzero(ends < len(truth))
        if not len(starts):
            break
        starts = starts[:: max(1, len(starts) // _STARTS)]
        a, b = starts, ends[starts]
        error = se2.between(se2.between(truth[a], truth[b]), se2.between(estimate[a], estimate[b]))
        shift = float(np.hypot(error[:, 0], error[:, 1]).mean())
        out.append(Drift(length, len(starts), shift, float(np.degrees(np.abs(error[:, 2])).mean())))
    return out
