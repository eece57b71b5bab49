"""Sparse symmetric matrices of 3x3 blocks: a good order of elimination, the factor, what it solves, marginals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mfslam.kernels import block_cholesky
from mfslam.types import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class Pattern:
    """Where a matrix of N blocks a side, with off-diagonal blocks at rows i and columns j (E,), and its factor stand.

    ``place`` (N,): the row of each unknown in the order of elimination. ``first`` (N + 1,), ``rows`` (F,): the columns
    of the factor. ``slots`` (E,): the entry of each given block, that of the later row and the earlier column.
    """

    place: IntArray
    first: IntArray
    rows: IntArray
    slots: IntArray

    @classmethod
    def of(cls, i: IntArray, j: IntArray, count: int) -> Pattern:
        """Of pairs i != j of unknowns 0 to ``count`` - 1; a pair may be given more than once."""
        place = elimination_order(i, j, count)
        low, high = np.minimum(place[i], place[j]), np.maximum(place[i], place[j])
        pairs, which = np.unique(high * count + low, return_inverse=True)
        first, rows = block_cholesky.factor_pattern(
            np.searchsorted(pairs // count, np.arange(count + 1)), pairs % count
        )
        # entries stand by column and then by row
        entries = np.repeat(np.arange(count), np.diff(first)) * count + rows
        slots = np.searchsorted(entries, pairs % count * count + pairs // count)
        return cls(place, first, rows, slots[which].astype(np.int64))


def elimination_order(i: IntArray, j: IntArray, count: int) -> IntArray:
    """Place (count,) of every unknown in an order that fills the factor little: minimum degree, which scipy's
    SuperLU finds on the way when it factorises anything of that pattern."""
    from scipy.sparse import coo_array, eye_array
    from scipy.sparse.linalg import splu

    links = coo_array((np.full(len(i), -1.0), (i, j)), shape=(count, count))
    degree = np.bincount(i, minlength=count) + np.bincount(j, minlength=count)
    pattern = (links + links.T + eye_array(count) * (1.0 + float(degree.max(initial=0)))).tocsc()
    factor = splu(pattern, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    return np.asarray(factor.perm_c, dtype=np.int64)


def inverse_diagonal(diagonal: FloatArray, i: IntArray, j: IntArray, ij: FloatArray) -> FloatArray:
    """(N, 3, 3) diagonal blocks of the inverse of the matrix with blocks ``diagonal`` (N, 3, 3) and, at rows ``i`` and
    columns ``j`` (E,), i != j, ``ij`` (E, 3, 3); of a pair i, j and j, i only one is given, and those of one place
    add up."""
    pattern = Pattern.of(i, j, len(diagonal))
    place = pattern.place
    # blocks below the diagonal: that of row j and column i is the transpose of ij
    blocks = np.where((place[j] > place[i])[:, None, None], np.swapaxes(ij, 1, 2), ij)
    below = np.zeros((len(pattern.rows), 3, 3))
    np.add.at(below, pattern.slots, blocks)
    out = np.empty_like(diagonal)
    out[place] = diagonal
    block_cholesky.factorise(pattern.first, pattern.rows, out, below)
    block_cholesky.invert_selected(pattern.first, pattern.rows, out, below)
    return np.asarray(out[place])
