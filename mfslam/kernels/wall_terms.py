"""What patches of wall say of the poses of the scans that saw them, the lines of the patches being eliminated.

The information of the poses is that of each scan alone less, for every patch, the products of its columns: one column of
3x2 for each group, the points of one scan on one patch. Kept like that it takes far less memory, and less time, than
as blocks between all pairs of scans that saw a patch.
"""

import math

import numpy as np

from mfslam.kernels.compiling import helper, kernel
from mfslam.types import FloatArray, IntArray


@helper
def _roots(patches: int, patch_of: IntArray, sums: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Per patch the lower triangle (3) of a root of the inverse of the line's block, zero where fewer than
    two scans saw it; and that root's transpose times the line's gradient (2)."""
    block, gradient = np.zeros((patches, 3)), np.zeros((patches, 2))
    scans = np.zeros(patches, np.int64)
    for g in range(patch_of.shape[0]):
        q = patch_of[g]
        scans[q] += 1
        for u in range(3):
            block[q, u] += sums[g, 12 + u]
        for u in range(2):
            gradient[q, u] += sums[g, 18 + u]
    root, rooted = np.zeros((patches, 3)), np.zeros((patches, 2))
    for q in range(patches):
        a, b, d = block[q, 0], block[q, 1], block[q, 2]
        det = a * d - b * b
        if scans[q] < 2 or not det > 1e-9 * a * d:
            continue
        root[q, 0] = math.sqrt(d / det)
        root[q, 1] = -b / det / root[q, 0]
        root[q, 2] = math.sqrt(max(0.0, a / det - root[q, 1] * root[q, 1]))
        rooted[q, 0] = root[q, 0] * gradient[q, 0] + root[q, 1] * gradient[q, 1]
        rooted[q, 1] = root[q, 2] * gradient[q, 1]
    return root, rooted


@kernel
def eliminate_lines(
    scans: int, patches: int, scan_of: IntArray, patch_of: IntArray, sums: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Schur complement of `wall_patches.group_sums` by the patches' lines, factorised.

    Returns ``own`` (K, 3, 3), the ``columns`` (M, 3, 2) of the groups, and the right-hand side (K, 3): the information
    of poses k and l is [k = l] own_k less, over the patches, the sum of column_kq column_lq^T.
    """
    root, rooted = _roots(patches, patch_of, sums)
    own, columns, rhs = np.zeros((scans, 3, 3)), np.zeros((patch_of.shape[0], 3, 2)), np.zeros((scans, 3))
    for g in range(patch_of.shape[0]):
        q, k = patch_of[g], scan_of[g]
        if root[q, 0] == 0.0:
            continue
        for u in range(3):
            columns[g, u, 0] = sums[g, 6 + u] * root[q, 0] + sums[g, 9 + u] * root[q, 1]
            columns[g, u, 1] = sums[g, 9 + u] * root[q, 2]
            rhs[k, u] += sums[g, 15 + u] - columns[g, u, 0] * rooted[q, 0] - columns[g, u, 1] * rooted[q, 1]
        own[k, 0, 0] += sums[g, 0]
        own[k, 0, 1] += sums[g, 1]
        own[k, 0, 2] += sums[g, 2]
        own[k, 1, 1] += sums[g, 3]
        own[k, 1, 2] += sums[g, 4]
        own[k, 2, 2] += sums[g, 5]
    for k in range(scans):
        own[k, 1, 0], own[k, 2, 0], own[k, 2, 1] = own[k, 0, 1], own[k, 0, 2], own[k, 1, 2]
    return own, columns, rhs


@kernel
def add_wall_product(
    own: FloatArray, columns: FloatArray, scan_of: IntArray, patch_of: IntArray, x: FloatArray, seen: FloatArray,
    out: FloatArray,
) -> None:  # fmt: skip
    """out += A x, of R vectors at once: ``x``, ``out`` (3 N, R), N >= K. ``seen`` (2 Q, R) zeros: room for what the
    patches make of them."""
    many = x.shape[1]
    for g in range(patch_of.shape[0]):
        k, q = 3 * scan_of[g], 2 * patch_of[g]
        for v in range(2):
            c0, c1, c2 = columns[g, 0, v], columns[g, 1, v], columns[g, 2, v]
            for r in range(many):
                seen[q + v, r] += c0 * x[k, r] + c1 * x[k + 1, r] + c2 * x[k + 2, r]
    for g in range(patch_of.shape[0]):
        k, q = 3 * scan_of[g], 2 * patch_of[g]
        for u in range(3):
            c0, c1 = columns[g, u, 0], columns[g, u, 1]
            for r in range(many):
                out[k + u, r] -= c0 * seen[q, r] + c1 * seen[q + 1, r]
    for k in range(own.shape[0]):
        for u in range(3):
            for r in range(many):
                out[3 * k + u, r] += (
                    own[k, u, 0] * x[3 * k, r]
                    + own[k, u, 1] * x[3 * k + 1, r]
                    + own[k, u, 2] * x[3 * k + 2, r]
                )


@kernel
def add_wall_stretches(
    own: FloatArray, columns: FloatArray, scan_of: IntArray, patch_of: IntArray, patches: int, size: int,
    carried: FloatArray, coarse_of: IntArray, within: FloatArray,
) -> tuple[FloatArray, FloatArray, IntArray, IntArray]:  # fmt: skip
    """The same matrix on two levels, as `half_matrix.add_stretches`.

    Adds the diagonal blocks of each stretch of ``size`` poses to ``within``. Returns the matrix of the coarse unknowns in the
    form of this one: own, columns, and coarse unknown and patch of each.
    """
    groups, scans = patch_of.shape[0], own.shape[0]
    coarse_own = np.zeros((coarse_of[scans - 1] + 1, 3, 3))
    coarse_columns = np.zeros((groups, 3, 2))
    coarse_scan, coarse_patch = np.empty(groups, np.int64), np.empty(groups, np.int64)
    slot = np.full(
        patches, -1, np.int64
    )  # the coarse column of each patch, of the stretch that is being filled
    newest, older = (
        np.full(patches, -1, np.int64),
        np.full(groups, -1, np.int64),
    )  # groups by patch, a linked list
    count = 0
    for g in range(groups):
        k, q = scan_of[g], patch_of[g]
        older[g] = newest[q]
        newest[q] = g
        at = slot[q]
        if at < 0 or coarse_scan[at] != coarse_of[k]:
            at = count
            slot[q], coarse_scan[at], coarse_patch[at] = at, coarse_of[k], q
            count += 1
        for u in range(3):
            for v in range(2):
                coarse_columns[at, u, v] += (
                    carried[k, 0, u] * columns[g, 0, v]
                    + carried[k, 1, u] * columns[g, 1, v]
                    + carried[k, 2, u] * columns[g, 2, v]
                )
        stretch, row = k // size, 3 * (k % size)
        h = g
        while h >= 0 and scan_of[h] // size == stretch:
            column = 3 * (scan_of[h] % size)
            for u in range(3):
                for v in range(3):
                    term = columns[g, u, 0] * columns[h, v, 0] + columns[g, u, 1] * columns[h, v, 1]
                    within[stretch, row + u, column + v] -= term
                    if h != g:
                        within[stretch, column + v, row + u] -= term
            h = older[h]
    half = np.empty((3, 3))
    for k in range(scans):
        stretch, row = k // size, 3 * (k % size)
        for u in range(3):
            for v in range(3):
                within[stretch, row + u, row + v] += own[k, u, v]
                half[u, v] = (
                    own[k, u, 0] * carried[k, 0, v]
                    + own[k, u, 1] * carried[k, 1, v]
                    + own[k, u, 2] * carried[k, 2, v]
                )
        for u in range(3):
            for v in range(3):
                coarse_own[coarse_of[k], u, v] += (
                    carried[k, 0, u] * half[0, v]
                    + carried[k, 1, u] * half[1, v]
                    + carried[k, 2, u] * half[2, v]
                )
    return coarse_own, coarse_columns[:count], coarse_scan[:count], coarse_patch[:count]


@kernel
def wall_blocks(
    own: FloatArray, columns: FloatArray, scan_of: IntArray, patch_of: IntArray, patches: int
) -> tuple[IntArray, IntArray, FloatArray]:
    """The matrix as blocks between all pairs of scans that saw a patch: the lower half, as `half_matrix.add_product`
    takes one. Groups come in order of scans."""
    scans, groups = own.shape[0], patch_of.shape[0]
    row_first, patch_first = np.zeros(scans + 1, np.int64), np.zeros(patches + 1, np.int64)
    for g in range(groups):
        row_first[scan_of[g] + 1] += 1
        patch_first[patch_of[g] + 1] += 1
    for k in range(scans):
        row_first[k + 1] += row_first[k]
    for q in range(patches):
        patch_first[q + 1] += patch_first[q]
    by_patch, fill = np.empty(groups, np.int64), patch_first.copy()
    for g in range(groups):
        by_patch[fill[patch_of[g]]] = g
        fill[patch_of[g]] += 1
    first, mark = np.zeros(scans + 1, np.int64), np.full(scans, -1, np.int64)
    for k in range(scans):
        first[k + 1] = first[k] + 1
        for g in range(row_first[k], row_first[k + 1]):
            for at in range(patch_first[patch_of[g]], patch_first[patch_of[g] + 1]):
                other = scan_of[by_patch[at]]
                if other >= k:
                    break
                if mark[other] != k:
                    mark[other] = k
                    first[k + 1] += 1
    column, blocks = np.empty(first[scans], np.int64), np.zeros((first[scans], 3, 3))
    slot = np.full(scans, -1, np.int64)
    for k in range(scans):
        free = first[k] + 1
        slot[k] = first[k]  # a row has its diagonal first
        column[first[k]] = k
        for u in range(3):
            for v in range(3):
                blocks[first[k], u, v] = own[k, u, v]
        for g in range(row_first[k], row_first[k + 1]):
            for at in range(patch_first[patch_of[g]], patch_first[patch_of[g] + 1]):
                h = by_patch[at]
                other = scan_of[h]
                if other > k:  # the mirror image of what that row will have
                    break
                b = slot[other]
                if b < first[k]:
                    b = free
                    free += 1
                    slot[other] = b
                    column[b] = other
                for u in range(3):
                    for v in range(3):
                        blocks[b, u, v] -= (
                            columns[g, u, 0] * columns[h, v, 0] + columns[g, u, 1] * columns[h, v, 1]
                        )
    return first, column, blocks
