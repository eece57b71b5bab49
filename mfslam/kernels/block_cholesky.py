"""Sparse symmetric matrices of 3x3 blocks: their factor L D L^T, what it solves, and blocks of their inverse."""

import numpy as np

from mfslam.kernels.compiling import helper, kernel
from mfslam.types import FloatArray, IntArray


@kernel
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


@helper
def _subtract_product(out: FloatArray, o: int, a: FloatArray, i: int, b: FloatArray, j: int) -> None:
    """out[o] -= a[i] b[j], of 3x3 blocks. By number: a block cut out as an array of its own costs as much again."""
    for u in range(3):
        for v in range(3):
            out[o, u, v] -= a[i, u, 0] * b[j, 0, v] + a[i, u, 1] * b[j, 1, v] + a[i, u, 2] * b[j, 2, v]


@helper
def _subtract_transposed_product(
    out: FloatArray, o: int, a: FloatArray, i: int, b: FloatArray, j: int
) -> None:
    """out[o] -= a[i]^T b[j]."""
    for u in range(3):
        for v in range(3):
            out[o, u, v] -= a[i, 0, u] * b[j, 0, v] + a[i, 1, u] * b[j, 1, v] + a[i, 2, u] * b[j, 2, v]


@helper
def _invert(a: FloatArray, j: int, out: FloatArray) -> None:
    """``out`` (1, 3, 3) becomes the inverse of block j, which is symmetric and positive definite."""
    c00 = a[j, 1, 1] * a[j, 2, 2] - a[j, 1, 2] * a[j, 2, 1]
    c01 = a[j, 1, 2] * a[j, 2, 0] - a[j, 1, 0] * a[j, 2, 2]
    c02 = a[j, 1, 0] * a[j, 2, 1] - a[j, 1, 1] * a[j, 2, 0]
    det = a[j, 0, 0] * c00 + a[j, 0, 1] * c01 + a[j, 0, 2] * c02
    out[0, 0, 0], out[0, 0, 1], out[0, 0, 2] = c00 / det, c01 / det, c02 / det
    out[0, 1, 1] = (a[j, 0, 0] * a[j, 2, 2] - a[j, 0, 2] * a[j, 2, 0]) / det
    out[0, 1, 2] = (a[j, 0, 2] * a[j, 1, 0] - a[j, 0, 0] * a[j, 1, 2]) / det
    out[0, 2, 2] = (a[j, 0, 0] * a[j, 1, 1] - a[j, 0, 1] * a[j, 1, 0]) / det
    out[0, 1, 0], out[0, 2, 0], out[0, 2, 1] = out[0, 0, 1], out[0, 0, 2], out[0, 1, 2]


@helper
def _copy_block(a: FloatArray, i: int, out: FloatArray, o: int) -> None:
    """Element by element: whole blocks at once take a second to compile."""
    for u in range(3):
        for v in range(3):
            out[o, u, v] = a[i, u, v]


@kernel
def factorise(first: IntArray, rows: IntArray, diagonal: FloatArray, below: FloatArray) -> None:
    """L D L^T in place: ``diagonal`` (N, 3, 3) becomes the inverse of D, ``below`` (E, 3, 3) the blocks of L.

    ``first``, ``rows``: the pattern of L; ``below`` holds the matrix in it, zero where L fills in.
    """
    n = diagonal.shape[0]
    inverse = np.empty((1, 3, 3))
    scaled = np.empty((1, 3, 3))
    for j in range(n):
        _invert(diagonal, j, inverse)
        _copy_block(inverse, 0, diagonal, j)
        end = first[j + 1]
        for q in range(first[j], end):
            b = rows[q]
            # scaled = D^-1 A_bj^T; then A_ab -= A_aj D^-1 A_bj^T
            for u in range(3):
                for v in range(3):
                    scaled[0, u, v] = (
                        inverse[0, u, 0] * below[q, v, 0]
                        + inverse[0, u, 1] * below[q, v, 1]
                        + inverse[0, u, 2] * below[q, v, 2]
                    )
            _subtract_product(diagonal, b, below, q, scaled, 0)
            # rows of column j below b are rows of column b too, in the same order
            entry = first[b]
            for e in range(q + 1, end):
                while rows[entry] != rows[e]:
                    entry += 1
                _subtract_product(below, entry, below, e, scaled, 0)
            # what is above in this column has been used: L_bj = (D^-1 A_bj^T)^T
            for u in range(3):
                for v in range(3):
                    below[q, u, v] = scaled[0, v, u]


@kernel
def substitute(
    first: IntArray, rows: IntArray, diagonal: FloatArray, below: FloatArray, x: FloatArray
) -> None:
    """The solution in place of the right-hand side ``x`` (N, 3), by what `factorise` left."""
    n = x.shape[0]
    for j in range(n):
        x0, x1, x2 = x[j, 0], x[j, 1], x[j, 2]
        for q in range(first[j], first[j + 1]):
            b = rows[q]
            for u in range(3):
                x[b, u] -= below[q, u, 0] * x0 + below[q, u, 1] * x1 + below[q, u, 2] * x2
    for j in range(n - 1, -1, -1):
        x0, x1, x2 = x[j, 0], x[j, 1], x[j, 2]
        for u in range(3):
            x[j, u] = diagonal[j, u, 0] * x0 + diagonal[j, u, 1] * x1 + diagonal[j, u, 2] * x2
        for q in range(first[j], first[j + 1]):
            b = rows[q]
            for u in range(3):
                x[j, u] -= below[q, 0, u] * x[b, 0] + below[q, 1, u] * x[b, 1] + below[q, 2, u] * x[b, 2]


@kernel
def invert_selected(first: IntArray, rows: IntArray, diagonal: FloatArray, below: FloatArray) -> None:
    """The inverse Z in the pattern of L, in place of what `factorise` left: ``diagonal`` becomes Z_jj. The recursion of
    Takahashi, Fagan and Chen (1973), without the inverse itself, which is full.

    From the last column to the first: Z_aj = -sum_b Z_ab L_bj, Z_jj = D_j^-1 - sum_a L_aj^T Z_aj, over the rows a, b
    of column j; all the Z_ab lie in the pattern and are known by then.
    """
    n = diagonal.shape[0]
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
            _subtract_product(z, q - start, diagonal, b, below, q)
            entry = first[b]
            for e in range(q + 1, end):
                while rows[entry] != rows[e]:
                    entry += 1
                _subtract_product(z, e - start, below, entry, below, q)
                _subtract_transposed_product(z, q - start, below, entry, below, e)
        for q in range(start, end):
            _subtract_transposed_product(diagonal, j, below, q, z, q - start)
        for q in range(start, end):
            _copy_block(z, q - start, below, q)
