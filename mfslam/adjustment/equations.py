"""Sparse normal equations whose unknowns come in threes: poses, errors of wheels."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from mfslam import se2
from mfslam.kernels import half_matrix
from mfslam.types import BoolArray, Float32Array, FloatArray, IntArray

HELD = 1e10  # information that nails an unknown
MOST_STEPS = 200  # of conjugate gradients
INVERTED = 64  # blocks of stretches at a time
STRETCH, MOST_STRETCHES = 6, 1200  # poses in a stretch, on logs that are not too long for it


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

    def matrix(self) -> HalfMatrix:
        """H, of 3x3 blocks."""
        rows, columns = np.concatenate(self._rows), np.concatenate(self._columns)
        lower = np.flatnonzero(columns <= rows)
        count = len(self.rhs)
        key, which = np.unique(rows[lower] * count + columns[lower], return_inverse=True)
        blocks = np.zeros((len(key), 3, 3))
        np.add.at(blocks, which, np.concatenate(self._blocks)[lower])
        return HalfMatrix(np.searchsorted(key // count, np.arange(count + 1)), key % count, blocks)


@dataclass(frozen=True, eq=False)
class HalfMatrix:
    """A symmetric matrix of N rows of 3x3 blocks, of which the lower half is kept: ``first`` block of each row (N + 1,),
    ``columns`` (B,) of the ``blocks`` (B, 3, 3)."""

    first: IntArray
    columns: IntArray
    blocks: FloatArray

    def add_product(self, x: FloatArray, out: FloatArray) -> None:
        """See `Part`."""
        half_matrix.add_product(self.first, self.columns, self.blocks, x, out)

    def add_stretches(
        self, size: int, carried: FloatArray, coarse_of: IntArray, within: FloatArray
    ) -> HalfMatrix:
        """See `Part`."""
        return HalfMatrix(
            *half_matrix.add_stretches(
                self.first, self.columns, self.blocks, size, carried, coarse_of, within
            )
        )

    def with_rows(self, count: int) -> HalfMatrix:
        """The matrix with empty rows at its end, ``count`` in all."""
        more = np.full(count + 1 - len(self.first), self.first[-1])
        return HalfMatrix(np.concatenate([self.first, more]), self.columns, self.blocks)

    def whole(self) -> Any:
        """Both halves, as a scipy CSR matrix (3 N, 3 N)."""
        from scipy.sparse import bsr_matrix

        count = len(self.first) - 1
        rows = np.repeat(np.arange(count), np.diff(self.first))
        above = np.flatnonzero(rows != self.columns)
        lower = bsr_matrix((self.blocks, self.columns, self.first), shape=(3 * count, 3 * count))
        order = above[np.argsort(self.columns[above], kind="stable")]
        starts = np.searchsorted(self.columns[order], np.arange(count + 1))
        mirrored = np.ascontiguousarray(np.swapaxes(self.blocks[order], 1, 2))
        upper = bsr_matrix((mirrored, rows[order], starts), shape=lower.shape)
        return lower.tocsr() + upper.tocsr()


class Part(Protocol):
    """A symmetric matrix of U rows of 3x3 blocks, of the unknowns in their order."""

    def add_product(self, x: FloatArray, out: FloatArray) -> None:
        """out += A x of vectors (3 U, R)."""

    def add_stretches(
        self, size: int, carried: FloatArray, coarse_of: IntArray, within: FloatArray
    ) -> HalfMatrix:
        """The matrix of the coarse unknowns that carry these, ``carried`` (U, 3, 3) of number ``coarse_of`` (U,); the diagonal
        blocks of each stretch of ``size`` unknowns are added to ``within`` (C, 3 size, 3 size)."""


class Solver:
    """Conjugate gradients on two levels: within stretches, and stretches of some successive poses that move as one
    body. The scans fix single poses well; what is slow to converge is how the log bends."""

    def __init__(self, world_T_body: FloatArray, others: int) -> None:
        """``world_T_body`` (K, 3): about where the poses stand; ``others``: unknowns after them."""
        from scipy.sparse import csr_matrix

        count = len(world_T_body)
        self._size = max(STRETCH, -(-count // MOST_STRETCHES))
        stretch = np.arange(count) // self._size
        middle = np.minimum(stretch * self._size + self._size // 2, count - 1)
        # a stretch moves by a perturbation at its middle
        carried = se2.adjoint(se2.between(world_T_body, world_T_body[middle]))
        carried = np.concatenate([carried, np.tile(np.eye(3), (others, 1, 1))])
        coarse = np.concatenate([stretch, stretch[-1] + 1 + np.arange(others)])
        self._carried, self._coarse_of = carried, coarse
        three = np.arange(3)
        rows = np.broadcast_to(3 * np.arange(count + others)[:, None, None] + three[:, None], carried.shape)
        columns = np.broadcast_to(3 * coarse[:, None, None] + three, carried.shape)
        shape = (3 * len(coarse), 3 * int(coarse[-1] + 1))
        self._carry = csr_matrix((carried.ravel(), (rows.ravel(), columns.ravel())), shape=shape)
        self._carry_back = self._carry.T.tocsr()
        self._parts: list[Part] = []
        self._coarse: Any = None
        self._own: Float32Array | None = None  # (C, 3 size, 3 size) inverse of each stretch's block
        self._precondition: Callable[[FloatArray], FloatArray] = np.copy

    def forget(self) -> None:
        """Give the matrix back."""
        self._parts, self._coarse, self._own, self._precondition = [], None, None, np.copy

    def take(self, parts: Sequence[Part]) -> None:
        """The next matrix, as the sum of its parts. Raises RuntimeError or LinAlgError where it is singular."""
        from scipy.sparse.linalg import splu

        self._parts = list(parts)
        unknowns = len(self._coarse_of)
        count, size = -(-unknowns // self._size), 3 * self._size
        within = np.zeros((count, size, size))
        coarse = [
            part.add_stretches(self._size, self._carried, self._coarse_of, within).with_rows(
                int(self._coarse_of[-1]) + 1
            )
            for part in self._parts
        ]
        filled_up = np.arange(3 * unknowns, count * size) % size
        within[-1, filled_up, filled_up] = 1.0
        # single precision: these are only read, to say about where the solution is
        own = np.empty(within.shape, np.float32)
        for first in range(0, count, INVERTED):
            own[first : first + INVERTED] = np.linalg.inv(within[first : first + INVERTED])
        del within  # before the coarse matrix and its factors are in memory
        self._coarse = sum(part.whole() for part in coarse)
        del coarse
        factors: Any = splu(  # the matrix is symmetric: its rows are its columns
            self._coarse.T, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
        )
        self._own = own
        carry, carry_back = self._carry, self._carry_back  # with self, only a collection would free it

        def precondition(rhs: FloatArray) -> FloatArray:
            padded = np.zeros((count, size, rhs.shape[1]), np.float32)
            padded.reshape(-1, rhs.shape[1])[: len(rhs)] = rhs
            single = (own @ padded).reshape(-1, rhs.shape[1])[: len(rhs)]
            return np.asarray(single + carry @ factors.solve(carry_back @ rhs))

        self._precondition = precondition

    def coarse(self) -> tuple[Any, Any]:
        """How stretches carry the unknowns (3 U, 3 C), and their information (3 C, 3 C): sparse."""
        return self._carry, self._coarse

    def play_within_stretches(self) -> FloatArray:
        """(U, 3, 3) covariance of each unknown while all that are not of its stretch are held. The first of them is held
        itself, and is said to play as the one after it."""
        assert self._own is not None
        inner = np.arange(self._size)
        blocks = self._own.reshape(len(self._own), self._size, 3, self._size, 3)[:, inner, :, inner, :]
        out = blocks.swapaxes(0, 1).reshape(-1, 3, 3)[: len(self._coarse_of)].astype(np.float64)
        out[0] = out[1]
        return out

    def _times(self, x: FloatArray) -> FloatArray:
        out = np.zeros_like(x)
        for part in self._parts:
            part.add_product(x, out)
        return out

    def solve(self, rhs: FloatArray, relative_error: float) -> FloatArray:
        """x of H x = ``rhs`` (3 U, R), of R right-hand sides at once: reading H is what takes time."""
        x, left = np.zeros_like(rhs), rhs.copy()
        # sums of products, not BLAS: its threads cost more than they bring here
        least = relative_error**2 * np.sum(rhs * rhs, axis=0)
        direction = np.zeros_like(rhs)
        before = np.full(rhs.shape[1], np.inf)
        for _ in range(MOST_STEPS):
            goes_on = np.sum(left * left, axis=0) > least
            if not goes_on.any():
                break
            near = self._precondition(left)
            after = np.sum(left * near, axis=0)
            direction = near + _ratio(after, before, goes_on) * direction
            before = after
            ahead = self._times(direction)
            step = _ratio(after, np.sum(direction * ahead, axis=0), goes_on)
            x += step * direction
            left -= step * ahead
        return x


def _ratio(a: FloatArray, b: FloatArray, where: BoolArray) -> FloatArray:
    return np.divide(a, b, out=np.zeros_like(a), where=where)
