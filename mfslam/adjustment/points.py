"""The points of all keyframes, one after the other: they are in memory once, whoever reads them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from mfslam.kernels import wall_patches
from mfslam.types import DeskewedScan, Float32Array, FloatArray, IntArray

# that are worked on at a time: what is made of them on the way takes several times their memory
CHUNK_POINTS = 500_000


@dataclass(frozen=True, eq=False)
class ScanPoints:
    """``points_m``, ``normals`` (P, 2) in the frame of their scan and ``beams`` (P,) of theirs, rows ``first`` (K + 1,) of the
    scans, their ``stamps_ns`` (K,), and the lasers ``origins_m`` (K, 2) in those frames. ``spare_m`` (P,): by how much farther
    the laser would have seen each."""

    points_m: FloatArray
    normals: FloatArray
    beams: IntArray
    first: IntArray
    stamps_ns: IntArray
    origins_m: FloatArray
    spare_m: Float32Array

    @classmethod
    def of(
        cls, scans: Iterable[DeskewedScan], most: int, origins_m: FloatArray, spare_m: Iterable[Float32Array]
    ) -> ScanPoints:
        """Of scans with ``most`` points in all at most; ``spare_m``: of all beams of each scan."""
        # memory is taken as it is filled, not here
        points_m, normals, beams = np.empty((most, 2)), np.empty((most, 2)), np.empty(most, np.int64)
        spare = np.empty(most, np.float32)
        first, stamps_ns = np.zeros(len(origins_m) + 1, np.int64), np.empty(len(origins_m), np.int64)
        for k, (scan, spare_of_beams) in enumerate(zip(scans, spare_m, strict=True)):
            first[k + 1] = first[k] + len(scan.points_m)
            rows = slice(first[k], first[k + 1])
            points_m[rows], normals[rows], beams[rows] = scan.points_m, scan.normals, scan.beams
            spare[rows] = spare_of_beams[scan.beams]
            stamps_ns[k] = scan.reference_ns
        some = slice(first[-1])
        return cls(points_m[some], normals[some], beams[some], first, stamps_ns, origins_m, spare[some])

    def scan(self, k: int) -> DeskewedScan:
        """A view of scan ``k``."""
        rows = slice(self.first[k], self.first[k + 1])
        return DeskewedScan(int(self.stamps_ns[k]), self.points_m[rows], self.normals[rows], self.beams[rows])

    def chunks(self) -> Sequence[slice]:
        """Scans, some at a time: all of them where they are not too many."""
        cuts = np.searchsorted(self.first, np.arange(0, self.first[-1], CHUNK_POINTS)).tolist()
        ends = [*cuts[1:], len(self.origins_m)]
        return [slice(a, b) for a, b in zip([0, *ends[:-1]], ends, strict=True)]

    def placed(self, poses: FloatArray, scans: slice) -> FloatArray:
        """(N, 4) points of some scans in the world, rows x, y, nx, ny, with all scans at ``poses`` (K, 3)."""
        first = self.first[scans.start : scans.stop + 1]
        out = np.empty((int(first[-1] - first[0]), 4))
        wall_patches.place_scans(self.points_m, self.normals, first, poses[scans], out)
        return out
