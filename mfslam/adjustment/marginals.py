"""How uncertain the adjusted poses are, on two levels: stretches of poses as rigid bodies, poses within their stretch.

The information of all poses by the walls that they share is too dense for an inverse on long logs. That of the
stretches is not; what it leaves out, the play of each pose within its stretch while all others are held, is added.
"""

from __future__ import annotations

import numpy as np

from mfslam import se2
from mfslam.adjustment.equations import Solver
from mfslam.sparse_blocks import inverse_diagonal
from mfslam.types import FloatArray, IntArray


class AdjustedInformation:
    """Covariances of K adjusted poses (K, 3), the first being the origin."""

    def __init__(self, world_T_body: FloatArray, solver: Solver, variance_scale: float) -> None:
        """``variance_scale``: how many times less sure everything is said to be than the solver's matrix says."""
        count = len(world_T_body)
        self.variance_scale = variance_scale
        self._world_T_body = world_T_body
        carry, coarse = solver.coarse()
        self._carried = carry[: 3 * count]
        self._coarse = coarse / variance_scale
        # the first pose plays as the others do: they are seen from it
        self._single = variance_scale * solver.play_within_stretches()[:count]
        # (K, 3) of each pose while its stretch is held, by the solver's matrix
        self.single_variances = np.diagonal(self._single, axis1=1, axis2=2) / variance_scale
        self._own = self._single

    def take_smoothed(self, variances: FloatArray) -> None:
        """Single poses have been smoothed since, and have ``variances`` (K, 3) now, in their tangents, as the solver's matrix
        says it of what they were before."""
        # rounding leaves nothing of one that the first pose's hold decides
        sound = np.all(self.single_variances > 0.0, axis=1)
        scale = np.sqrt(variances / np.where(sound[:, None], self.single_variances, 1.0))
        variances = self.variance_scale * variances
        scaled = scale[:, :, None] * self._single * scale[:, None, :]
        self._own = np.where(sound[:, None, None], scaled, variances[:, :, None] * np.eye(3))

    def marginals(self) -> FloatArray:
        """(K, 3, 3) covariance of every pose relative to the first one, in the tangent at the pose."""
        coarse = self._coarse.tobsr((3, 3))
        coarse.sort_indices()
        rows, columns = np.repeat(np.arange(len(coarse.indptr) - 1), np.diff(coarse.indptr)), coarse.indices
        diagonal = np.zeros((len(coarse.indptr) - 1, 3, 3))
        diagonal[rows[rows == columns]] = coarse.data[rows == columns]
        upper = rows < columns
        inverse = inverse_diagonal(diagonal, rows[upper], columns[upper].astype(np.int64), coarse.data[upper])
        carry = self._carried.tobsr((3, 3))  # one block per pose
        out = carry.data @ inverse[carry.indices] @ np.swapaxes(carry.data, 1, 2) + self._own
        from_first = se2.adjoint(se2.between(self._world_T_body, self._world_T_body[:1]))
        out += from_first @ self._own[0] @ np.swapaxes(from_first, 1, 2)
        out[0] = 0.0
        return np.asarray(out)

    def relative_covariances(self, i: IntArray, j: IntArray) -> FloatArray:
        """(N, 3, 3) covariance of the motion from pose i to pose j (N,), in the tangent at j."""
        from scipy.sparse.linalg import splu

        factor = splu(
            self._coarse.tocsc(),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
        adjoints = se2.adjoint(se2.between(self._world_T_body[j], self._world_T_body[i]))
        out = self._own[j] + adjoints @ self._own[i] @ np.swapaxes(adjoints, 1, 2)
        for n, (a, b) in enumerate(zip(i.tolist(), j.tolist(), strict=True)):
            at_b, at_a = (self._carried[3 * k : 3 * k + 3].toarray() for k in (b, a))
            rows = at_b - adjoints[n] @ at_a
            out[n] += rows @ factor.solve(np.ascontiguousarray(rows.T))
        return np.asarray(out)
