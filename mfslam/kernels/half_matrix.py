"""Symmetric matrices of 3x3 blocks of which only the lower half is kept: its rows, compressed, columns in any order."""

from __future__ import annotations

import numpy as np

from mfslam.kernels.compiling import kernel
from mfslam.types import FloatArray, IntArray


@kernel
def add_product(
    first: IntArray, columns: IntArray, blocks: FloatArray, x: FloatArray, out: FloatArray
) -> None:
    """out += A x, of R vectors at once: ``x``, ``out`` (3 N, R).

    A by the first block of each row (N + 1,), ``columns`` and ``blocks`` (B, 3, 3). What this costs is reading the blocks.
    """
    for k in range(first.shape[0] - 1):
        for b in range(first[k], first[k + 1]):
            j = columns[b]
            b00, b01, b02 = blocks[b, 0, 0], blocks[b, 0, 1], blocks[b, 0, 2]
            b10, b11, b12 = blocks[b, 1, 0], blocks[b, 1, 1], blocks[b, 1, 2]
            b20, b21, b22 = blocks[b, 2, 0], blocks[b, 2, 1], blocks[b, 2, 2]
            for r in range(x.shape[1]):
                x0, x1, x2 = x[3 * j, r], x[3 * j + 1, r], x[3 * j + 2, r]
                out[3 * k, r] += b00 * x0 + b01 * x1 + b02 * x2
                out[3 * k + 1, r] += b10 * x0 + b11 * x1 + b12 * x2
                out[3 * k + 2, r] += b20 * x0 + b21 * x1 + b22 * x2
                if j != k:
                    x0, x1, x2 = x[3 * k, r], x[3 * k + 1, r], x[3 * k + 2, r]
                    out[3 * j, r] += b00 * x0 + b10 * x1 + b20 * x2
                    out[3 * j + 1, r] += b01 * x0 + b11 * x1 + b21 * x2
                    out[3 * j + 2, r] += b02 * x0 + b12 * x1 + b22 * x2


@kernel
def add_stretches(
    first: IntArray, columns: IntArray, blocks: FloatArray, size: int, carried: FloatArray, coarse_of: IntArray,
    within: FloatArray,
) -> tuple[IntArray, IntArray, FloatArray]:  # fmt: skip
    """The matrix on two levels: of unknowns that are carried by coarse ones, and within stretches of ``size``.

    ``carried`` (N, 3, 3): d(unknown) / d(coarse unknown ``coarse_of`` (N,), which rises). The diagonal blocks of each stretch
    are added to ``within`` (-, 3 size, 3 size). Returns the coarse matrix as `add_product` takes one.
    """
    rows = first.shape[0] - 1
    coarse_rows = coarse_of[rows - 1] + 1
    coarse_first = np.zeros(coarse_rows + 1, np.int64)
    slot = np.full(coarse_rows, -1, np.int64)  # of each column, in the row that is being filled
    coarse_columns = np.empty(first[rows] + coarse_rows, np.int64)
    count = 0
    for k in range(rows):  # which blocks there are
        c = coarse_of[k]
        begin = coarse_first[c]
        if k == 0 or coarse_of[k - 1] != c:
            begin = count
            coarse_first[c] = begin
            coarse_columns[count], slot[c] = c, count
            count += 1
        for b in range(first[k], first[k + 1]):
            d = coarse_of[columns[b]]
            if slot[d] < begin:
                coarse_columns[count], slot[d] = d, count
                count += 1
    coarse_first[coarse_rows] = count
    sums = np.zeros((count, 3, 3))
    half = np.empty((3, 3))
    slot[:] = -1
    for k in range(rows):
        c = coarse_of[k]
        if k == 0 or coarse_of[k - 1] != c:
            for b in range(coarse_first[c], coarse_first[c + 1]):
                slot[coarse_columns[b]] = b
        for b in range(first[k], first[k + 1]):
            j = columns[b]
            for u in range(3):
                for v in range(3):
                    half[u, v] = (
                        carried[k, 0, u] * blocks[b, 0, v]
                        + carried[k, 1, u] * blocks[b, 1, v]
                        + carried[k, 2, u] * blocks[b, 2, v]
                    )
            at = slot[coarse_of[j]]
            mirrored = j != k and coarse_of[j] == c
            for u in range(3):
                for v in range(3):
                    term = (
                        half[u, 0] * carried[j, 0, v]
                        + half[u, 1] * carried[j, 1, v]
                        + half[u, 2] * carried[j, 2, v]
                    )
                    sums[at, u, v] += term
                    if mirrored:
                        sums[at, v, u] += term
            if k // size == j // size:
                row, column = 3 * (k % size), 3 * (j % size)
                for u in range(3):
                    for v in range(3):
                        within[k // size, row + u, column + v] += blocks[b, u, v]
                        if j != k:
                            within[k // size, column + v, row + u] += blocks[b, u, v]
    return coarse_first, coarse_columns[:count], sums
