"""Sparse normal equations whose unknowns come in threes: poses, errors of wheels."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from mfslam import se2
from mfslam.kernels import block_cholesky
from mfslam.types import FloatArray, IntArray

HELD = 1e10  # information that nails an unknown
RELATIVE_ERROR, MOST_STEPS = 1e-4, 200  # of conjugate gradients
STRETCH = 6


class Equations:
    """H x = b of ``count`` unknowns of three numbers each."""

    def __init__(self, count: int) -> None:
        self.rhs = np.zeros((count, 3))
        self._rows: list[IntArray] = []
        self._columns: list[IntArray] = []
        self._blocks: list[FloatArray] = []

    def add(
        self, parts: Sequence[tuple[IntArray, FloatArray]], error: FloatArray, information: FloatArray
    ) -> None:
        """Terms e^T W e: ``error`` (N, 3), ``information`` (N, 3, 3), and for every unknown that takes part its
        number (N,) and de/dx (N, 3, 3)."""
        weighted = [np.swapaxes(jacobian, 1, 2) @ information for _, jacobian in parts]
        for a, (at, _) in enumerate(parts):
            np.subtract.at(self.rhs, at, (weighted[a] @ error[:, :, None])[:, :, 0])
            for other, jacobian in parts:
                self._rows.append(at)
                self._columns.append(other)
                self._blocks.append(weighted[a] @ jacobian)

    def hold(self, number: int) -> None:
        """Nail an unknown where it is."""
        at, still = np.array([number]), np.eye(3)[None]
        self.add([(at, still)], np.zeros((1, 3)), HELD * still)

    def matrix(self) -> Any:
        """H as a scipy BSR matrix of 3x3 blocks."""
        rows, columns = np.concatenate(self._rows), np.concatenate(self._columns)
        count = len(self.rhs)
        key, which = np.unique(rows * count + columns, return_inverse=True)
        blocks = np.zeros((len(key), 3, 3))
        np.add.at(blocks, which, np.concatenate(self._blocks))
        return block_matrix(np.searchsorted(key // count, np.arange(count + 1)), key % count, blocks, count)


def block_matrix(first: IntArray, columns: IntArray, blocks: FloatArray, count: int) -> Any:
    """Sparse matrix of ``count`` rows and columns of 3x3 blocks, from compressed rows of them (the last rows may
    be left out)."""
    from scipy.sparse import bsr_matrix

    starts = np.concatenate([first, np.full(count + 1 - len(first), first[-1])])
    return bsr_matrix((blocks, columns, starts), shape=(3 * count, 3 * count))


class Solver:
    """Conjugate gradients on two levels: within stretches, and stretches of ``STRETCH`` successive poses that
    move as one body. The scans fix single poses well; what is slow to converge is how the log bends."""

    def __init__(self, world_T_body: FloatArray, others: int) -> None:
        """``world_T_body`` (K, 3): about where the poses stand; ``others``: unknowns after them."""
        from scipy.sparse import csr_matrix

        count = len(world_T_body)
        stretch = np.arange(count) // STRETCH
        middle = np.minimum(stretch * STRETCH + STRETCH // 2, count - 1)
        # a stretch moves by a perturbation at its middle
        carried = se2.adjoint(se2.between(world_T_body, world_T_body[middle]))
        carried = np.concatenate([carried, np.tile(np.eye(3), (others, 1, 1))])
        coarse = np.concatenate([stretch, stretch[-1] + 1 + np.arange(others)])
        three = np.arange(3)
        rows = np.broadcast_to(3 * np.arange(count + others)[:, None, None] + three[:, None], carried.shape)
        columns = np.broadcast_to(3 * coarse[:, None, None] + three, carried.shape)
        shape = (3 * len(coarse), 3 * int(coarse[-1] + 1))
        self._carry = csr_matrix((carried.ravel(), (rows.ravel(), columns.ravel())), shape=shape)
        self._parts: list[Any] = []
        self._precondition: Callable[[FloatArray], FloatArray] = np.copy

    def forget(self) -> None:
        """Give the matrix back."""
        self._parts, self._precondition = [], np.copy

    def take(self, parts: Sequence[Any]) -> None:
        """The next matrix, as the sum of its parts (`block_matrix`). Raises RuntimeError where it is singular."""
        from scipy.sparse.linalg import splu

        self._parts = list(parts)
        carry, coarse = self.coarse()
        carry_back = carry.T.tocsr()
        factors: Any = splu(
            coarse.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
        )
        own = np.linalg.inv(self.within_stretches())
        count, size = own.shape[:2]

        def precondition(rhs: FloatArray) -> FloatArray:
            padded = np.zeros((count, size, 1))
            padded.ravel()[: len(rhs)] = rhs
            single = (own @ padded).ravel()[: len(rhs)]
            return np.asarray(single + carry @ factors.solve(carry_back @ rhs))

        self._precondition = precondition

    def coarse(self) -> tuple[Any, Any]:
        """How stretches carry the unknowns (3 U, 3 C), and their information (3 C, 3 C): sparse."""
        carry_back = self._carry.T.tocsr()
        return self._carry, sum(carry_back @ part.tocsr() @ self._carry for part in self._parts).tocsr()

    def within_stretches(self) -> FloatArray:
        """(C, 3 STRETCH, 3 STRETCH) information of the unknowns of each stretch, all others being held."""
        count = -(-self._parts[0].shape[0] // (3 * STRETCH))
        return np.asarray(sum(_within_stretches(part, count) for part in self._parts))

    def _times(self, x: FloatArray) -> FloatArray:
        out = np.zeros_like(x)
        for part in self._parts:
            block_cholesky.add_product(part.indptr, part.indices, part.data, x, out)
        return out

    def solve(self, rhs: FloatArray, relative_error: float = RELATIVE_ERROR) -> FloatArray:
        x, left = np.zeros_like(rhs), rhs.copy()
        if not rhs.any():
            return x
        # sums of products, not BLAS: its threads cost more than they bring here
        least = relative_error**2 * np.sum(rhs * rhs)
        near = self._precondition(left)
        direction, before = near, np.sum(left * near)
        for _ in range(MOST_STEPS):
            ahead = self._times(direction)
            step = before / np.sum(direction * ahead)
            x += step * direction
            left -= step * ahead
            if not np.sum(left * left) > least:
                break
            near = self._precondition(left)
            after = np.sum(left * near)
            direction = near + (after / before) * direction
            before = after
        return x


def _within_stretches(matrix: Any, count: int) -> FloatArray:
    """(count, 3 STRETCH, 3 STRETCH) diagonal blocks of the matrix, filled up with ones at its end."""
    rows = np.repeat(np.arange(len(matrix.indptr) - 1), np.diff(matrix.indptr))
    columns = matrix.indices
    inside = rows // STRETCH == columns // STRETCH
    rows, columns = rows[inside], columns[inside]
    out = np.zeros((count, STRETCH, 3, STRETCH, 3))
    out[rows // STRETCH, rows % STRETCH, :, columns % STRETCH, :] = matrix.data[inside]
    square = out.reshape(count, 3 * STRETCH, 3 * STRETCH)
    for row in range(matrix.shape[0] % (3 * STRETCH) or 3 * STRETCH, 3 * STRETCH):
        square[-1, row, row] = 1.0
    return square
