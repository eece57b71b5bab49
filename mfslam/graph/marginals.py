"""How uncertain every pose of a solved graph is: marginal covariances relative to the first pose."""

from __future__ import annotations

from typing import Any

import numpy as np

from mfslam import se2
from mfslam.sparse_blocks import inverse_diagonal
from mfslam.trajectory import spread_covariances
from mfslam.types import Edge, FloatArray, IntArray

FLOOR = 1e-6  # information that every pose has: 1 km, 1000 rad


class GraphInformation:
    """Information of K poses by E edges at a solution, in the tangents of the poses (right perturbations).

    The first pose is the origin and has no uncertainty: what is said of the others is relative to it.
    """

    def __init__(self, world_T_body: FloatArray, edges: list[Edge]) -> None:
        """``world_T_body`` (K, 3). Edges count with the weight that the robust solve left them."""
        self.count, self._world_T_body = len(world_T_body), world_T_body
        used = [e for e in edges if e.weight > 0.0]
        self.i = np.array([e.i for e in used], dtype=np.int64)
        self.j = np.array([e.j for e in used], dtype=np.int64)
        self.jj = np.array([e.weight * e.information for e in used], dtype=np.float64).reshape(-1, 3, 3)
        # the residual log(measured^-1 i_T_j) moves by xi_j - Ad(j_T_i) xi_i; that of a unary edge by xi_j alone
        of_i = -se2.adjoint(se2.between(world_T_body[self.j], world_T_body[self.i]))
        of_i[self.i == self.j] = 0.0
        self.ij = np.swapaxes(of_i, 1, 2) @ self.jj
        self.ii = self.ij @ of_i

    def diagonal(self) -> FloatArray:
        """(K, 3, 3) information of each pose, the others being known."""
        out = np.tile(FLOOR * np.eye(3), (self.count, 1, 1))
        np.add.at(out, self.i, self.ii)
        np.add.at(out, self.j, self.jj)
        return out

    def marginals(self) -> FloatArray:
        """(K, 3, 3) covariance of every pose relative to the first one, in the tangent at the pose."""
        out = np.zeros((self.count, 3, 3))
        if self.count < 2:
            return out
        binary = (self.i != self.j) & (self.i > 0) & (self.j > 0)
        out[1:] = inverse_diagonal(
            self.diagonal()[1:], self.i[binary] - 1, self.j[binary] - 1, self.ij[binary]
        )
        return out

    def relative_covariances(self, i: IntArray, j: IntArray) -> FloatArray:
        """(N, 3, 3) covariance of the motion from pose i to pose j (N,), in the tangent at j, under their joint
        marginal. One solve per pair: milliseconds for thousands of poses."""
        from scipy.sparse.linalg import splu

        factor = splu(
            self.matrix(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
        )
        out = np.empty((len(i), 3, 3))
        adjoints = se2.adjoint(se2.between(self._world_T_body[j], self._world_T_body[i]))
        for n, (a, b) in enumerate(zip(i.tolist(), j.tolist(), strict=True)):
            rows = np.zeros((3 * self.count, 3))
            rows[3 * b : 3 * b + 3] = np.eye(3)
            rows[3 * a : 3 * a + 3] -= adjoints[n].T
            out[n] = rows[3:].T @ factor.solve(rows[3:])
        return out

    def matrix(self) -> Any:
        """The information of all poses but the first as a scipy.sparse CSC matrix (3K - 3, 3K - 3)."""
        from scipy.sparse import coo_array

        every = np.arange(self.count)
        rows, columns = np.concatenate([every, self.i, self.j]), np.concatenate([every, self.j, self.i])
        blocks = np.concatenate([self.diagonal(), self.ij, np.swapaxes(self.ij, 1, 2)])
        inner = np.arange(3)
        at_row = np.broadcast_to(3 * rows[:, None, None] + inner[:, None], blocks.shape)
        at_column = np.broadcast_to(3 * columns[:, None, None] + inner, blocks.shape)
        shape = (3 * self.count, 3 * self.count)
        return coo_array((blocks.ravel(), (at_row.ravel(), at_column.ravel())), shape=shape).tocsc()[3:, 3:]


def scan_covariances(
    world_T_body: FloatArray, keyframes: IntArray, edges: list[Edge], marginals: FloatArray | None = None
) -> FloatArray:
    """(S, 3, 3) covariance of every scan's x, y and yaw, in the world's axes and relative to the first keyframe.

    ``world_T_body`` (S, 3), ``keyframes`` (K,): their scans, which the edges number; ``marginals`` (K, 3, 3) of the
    keyframes, where the edges are not what placed them.
    """
    if marginals is None:
        marginals = GraphInformation(world_T_body[keyframes], edges).marginals()
    steps = np.tile(FLOOR * np.eye(3), (max(0, len(keyframes) - 1), 1, 1))
    for edge in edges:
        if edge.j == edge.i + 1:
            steps[edge.i] += edge.weight * edge.information
    inverse: FloatArray = np.asarray(np.linalg.inv(steps), dtype=np.float64)
    return spread_covariances(marginals, inverse, world_T_body, keyframes)
