"""Diagonal blocks of the inverse of a sparse symmetric matrix of 3x3 blocks."""

from __future__ import annotations

import numpy as np

from mfslam.kernels import selected_inverse
from mfslam.types import FloatArray, IntArray


def inverse_diagonal(diagonal: FloatArray, i: IntArray, j: IntArray, ij: FloatArray) -> FloatArray:
    """(N, 3, 3) diagonal blocks of the inverse of the matrix with blocks ``diagonal`` (N, 3, 3) and, at rows ``i`` and
    columns ``j`` (E,), i != j, ``ij`` (E, 3, 3); of a pair i, j and j, i only one is given, and those of one place
    add up."""
    count = len(diagonal)
    place = _elimination_order(i, j, count)
    low, high = np.minimum(place[i], place[j]), np.maximum(place[i], place[j])
    # blocks below the diagonal, (high, low): that of row j and column i is the transpose of ij
    blocks = np.where((place[j] > place[i])[:, None, None], np.swapaxes(ij, 1, 2), ij)
    pairs, which = np.unique(high * count + low, return_inverse=True)
    first, rows = selected_inverse.factor_pattern(
        np.searchsorted(pairs // count, np.arange(count + 1)), pairs % count
    )
    entries = np.repeat(np.arange(count), np.diff(first)) + rows * count  # one key per entry of the factor
    order = np.argsort(entries)
    below = np.zeros((len(rows), 3, 3))
    np.add.at(below, order[np.searchsorted(entries[order], pairs)][which], blocks)
    out = np.empty((count, 3, 3))
    out[place] = diagonal
    selected_inverse.factorise(first, rows, out, below)
    selected_inverse.invert_selected(first, rows, out, below)
    return np.asarray(out[place])


def _elimination_order(i: IntArray, j: IntArray, count: int) -> IntArray:
    """Place (count,) of every unknown in an order that fills the factor little: minimum degree, which scipy's
    SuperLU finds on the way when it factorises anything of that pattern."""
    from scipy.sparse import coo_array, eye_array
    from scipy.sparse.linalg import splu

    links = coo_array((np.full(len(i), -1.0), (i, j)), shape=(count, count))
    degree = np.bincount(i, minlength=count) + np.bincount(j, minlength=count)
    pattern = (links + links.T + eye_array(count) * (1.0 + float(degree.max()))).tocsc()
    factor = splu(pattern, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    return np.asarray(factor.perm_c, dtype=np.int64)
