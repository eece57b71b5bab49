"""Blocks of the inverse of a sparse symmetric matrix of 3x3 blocks, where its Cholesky factor has blocks: the
recursion of Takahashi, Fagan and Chen (1973), without the inverse itself, which is full."""

import numpy as np
from numba import njit

from mfslam.types import FloatArray, IntArray


@njit(cache=True, nogil=True)
def factor_pattern(starts: IntArray, columns: IntArray) -> tuple[IntArray, IntArray]:
    """Where the factor L of a symmetric matrix has blocks below its diagonal.

    The matrix is given by rows: row i has blocks at ``columns[starts[i]:starts[i + 1]]``, those left of the
    diagonal count. Returns the first entry of each column of L (N + 1,) and the row of each entry, ascending.
    Row i of L is the union of paths up the elimination tree from the blocks of row i (Liu 1990).
    """
    n = starts.shape[0] - 1
    parent = np.full(n, -1, np.int64)
    counts = np.zeros(n, np.int64)
    first = np.zeros(n + 1, np.int64)
    rows = np.empty(0, np.int64)
    for fill in range(2):  # count, then write
        seen = np.full(n, -1, np.int64)
        for i in range(n):
            seen[i] = i
            for q in range(starts[i], starts[i + 1]):
                k = columns[q]
                if k >= i:
                    continue
                while seen[k] != i:
                    seen[k] = i
                    if fill:
                        rows[first[k] + counts[k]] = i
                    counts[k] += 1
                    if parent[k] < 0:
                        parent[k] = i
                    k = parent[k]
        if not fill:
            for i in range(n):
                first[i + 1] = first[i] + counts[i]
                counts[i] = 0
            rows = np.empty(first[n], np.int64)
    return first, rows


@njit
def _subtract_product(out: FloatArray, a: FloatArray, b: FloatArray, transposed: bool) -> None:
    """out -= a b, or a^T b, of 3x3 blocks."""
    for u in range(3):
        for v in range(3):
            for k in range(3):
                out[u, v] -= (a[k, u] if transposed else a[u, k]) * b[k, v]


@njit
def _inverse(a: FloatArray, out: FloatArray) -> None:
    """Inverse of a 3x3 block that is symmetric and positive definite."""
    c00 = a[1, 1] * a[2, 2] - a[1, 2] * a[2, 1]
    c01 = a[1, 2] * a[2, 0] - a[1, 0] * a[2, 2]
    c02 = a[1, 0] * a[2, 1] - a[1, 1] * a[2, 0]
    det = a[0, 0] * c00 + a[0, 1] * c01 + a[0, 2] * c02
    out[0, 0], out[0, 1], out[0, 2] = c00 / det, c01 / det, c02 / det
    out[1, 1] = (a[0, 0] * a[2, 2] - a[0, 2] * a[2, 0]) / det
    out[1, 2] = (a[0, 2] * a[1, 0] - a[0, 0] * a[1, 2]) / det
    out[2, 2] = (a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0]) / det
    out[1, 0], out[2, 0], out[2, 1] = out[0, 1], out[0, 2], out[1, 2]


@njit
def _copy_block(block: FloatArray, out: FloatArray) -> None:
    """Element by element: whole blocks at once take a second to compile."""
    for u in range(3):
        for v in range(3):
            out[u, v] = block[u, v]


@njit(cache=True, nogil=True)
def factorise(first: IntArray, rows: IntArray, diagonal: FloatArray, below: FloatArray) -> None:
    """L D L^T in place: ``diagonal`` (N, 3, 3) becomes the inverse of D, ``below`` (E, 3, 3) the blocks of L.

    ``first``, ``rows``: the pattern of L; ``below`` holds the matrix in it, zero where L fills in.
    """
    n = diagonal.shape[0]
    place = np.full(n, -1, np.int64)
    inverse = np.empty((3, 3))
    scaled = np.empty((3, 3))
    for j in range(n):
        _inverse(diagonal[j], inverse)
        for q in range(first[j], first[j + 1]):
            b = rows[q]
            for e in range(first[b], first[b + 1]):
                place[rows[e]] = e
            # scaled = D^-1 A_bj^T; then A_ab -= A_aj D^-1 A_bj^T
            for u in range(3):
                for v in range(3):
                    scaled[u, v] = 0.0
                    for k in range(3):
                        scaled[u, v] += inverse[u, k] * below[q, v, k]
            _subtract_product(diagonal[b], below[q], scaled, False)
            for e in range(q + 1, first[j + 1]):
                _subtract_product(below[place[rows[e]]], below[e], scaled, False)
        for q in range(first[j], first[j + 1]):
            for u in range(3):
                for v in range(3):
                    scaled[u, v] = 0.0
                    for k in range(3):
                        scaled[u, v] += below[q, u, k] * inverse[k, v]
            _copy_block(scaled, below[q])
        _copy_block(inverse, diagonal[j])


@njit(cache=True, nogil=True)
def invert_selected(first: IntArray, rows: IntArray, diagonal: FloatArray, below: FloatArray) -> None:
    """The inverse Z in the pattern of L, in place of what `factorise` left: ``diagonal`` becomes Z_jj.

    From the last column to the first: Z_aj = -sum_b Z_ab L_bj, Z_jj = D_j^-1 - sum_a L_aj^T Z_aj, over the rows a, b
    of column j; all the Z_ab lie in the pattern and are known by then.
    """
    n = diagonal.shape[0]
    place = np.full(n, -1, np.int64)
    widest = 0
    for j in range(n):
        widest = max(widest, first[j + 1] - first[j])
    z = np.empty((widest, 3, 3))
    for j in range(n - 1, -1, -1):
        start, end = first[j], first[j + 1]
        for q in range(end - start):
            for u in range(3):
                for v in range(3):
                    z[q, u, v] = 0.0
        for q in range(start, end):
            b = rows[q]
            for e in range(first[b], first[b + 1]):
                place[rows[e]] = e
            _subtract_product(z[q - start], diagonal[b], below[q], False)
            for e in range(q + 1, end):
                block = below[place[rows[e]]]
                _subtract_product(z[e - start], block, below[q], False)
                _subtract_product(z[q - start], block, below[e], True)
        for q in range(start, end):
            _subtract_product(diagonal[j], below[q], z[q - start], True)
        for q in range(start, end):
            _copy_block(z[q - start], below[q])
