"""The information of poses by walls that they share: a matrix that is never written out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mfslam.adjustment.equations import HalfMatrix
from mfslam.kernels import wall_terms
from mfslam.types import Float32Array, FloatArray, Int32Array, IntArray


@dataclass(frozen=True, eq=False)
class Walls:
    """Of K poses by M groups of points on ``patches`` patches, in order of poses: see `wall_terms.eliminate_lines`.

    ``own`` (K, 3, 3), ``columns`` (M, 3, 2), ``scan_of`` and ``patch_of`` (M,). Single precision is enough for the columns:
    reading them is what a product costs, and the right-hand side, which says where the solution is, has none of it.
    """

    own: FloatArray
    columns: Float32Array | FloatArray
    scan_of: Int32Array
    patch_of: Int32Array
    patches: int

    def add_product(self, x: FloatArray, out: FloatArray) -> None:
        """See `equations.Part`; further unknowns after the poses are left alone."""
        seen = np.zeros((2 * self.patches, x.shape[1]))
        wall_terms.add_wall_product(self.own, self.columns, self.scan_of, self.patch_of, x, seen, out)

    def add_stretches(
        self, size: int, carried: FloatArray, coarse_of: IntArray, within: FloatArray
    ) -> HalfMatrix:
        """See `equations.Part`."""
        own, columns, scan_of, patch_of = wall_terms.add_wall_stretches(
            self.own,
            self.columns,
            self.scan_of,
            self.patch_of,
            self.patches,
            size,
            carried,
            coarse_of,
            within,
        )
        return Walls(own, columns, scan_of, patch_of, self.patches).blocks()

    def blocks(self) -> HalfMatrix:
        """Written out: a block for each pair of poses that share a patch."""
        return HalfMatrix(
            *wall_terms.wall_blocks(self.own, self.columns, self.scan_of, self.patch_of, self.patches)
        )
