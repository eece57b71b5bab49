"""What patches of wall say of the poses of the scans that saw them, the lines of the patches being eliminated.

The information of the poses is that of each scan alone less, for every patch, the products of its columns: one column of
3x2 for each group, the points of one scan on one patch. Kept like that it takes far less memory, and less time, than
as blocks between all pairs of scans that saw a patch.
"""

import math

import numpy as np

from mfslam.kernels.compiling import kernel
from mfslam.types import Float32Array, FloatArray, Int32Array, IntArray


@kernel
def add_line_terms(patch_of: Int32Array, sums: FloatArray, terms: FloatArray) -> None:
    """Add groups (M,) to the ``terms`` (Q, 7) of the lines of their patches: block (3), gradient (2), number of scans, and chi2 of
    where the scans saw it."""
    for g in range(patch_of.shape[0]):
        q = patch_of[g]
        for u in range(3):
            terms[q, u] += sums[g, 12 + u]
        terms[q, 3] += sums[g, 18]
        terms[q, 4] += sums[g, 19]
        terms[q, 5] += 1.0
        terms[q, 6] += sums[g, 18] * sums[g, 18] / sums[g, 12]


@kernel
def line_roots(terms: FloatArray) -> FloatArray:
    """Per patch (Q, 5) the lower triangle (3) of a root of the inverse of the line's block, zero where fewer than
    two scans saw it; and that root's transpose times the line's gradient (2)."""
    out = np.zeros((terms.shape[0], 5))
    for q in range(terms.shape[0]):
        a, b, d = terms[q, 0], terms[q, 1], terms[q, 2]
        det = a * d - b * b
        if terms[q, 5] < 2.0 or not det > 1e-9 * a * d:
            continue
        out[q, 0] = math.sqrt(d / det)
        out[q, 1] = -b / det / out[q, 0]
        out[q, 2] = math.sqrt(max(0.0, a / det - out[q, 1] * out[q, 1]))
        out[q, 3] = out[q, 0] * terms[q, 3] + out[q, 1] * terms[q, 4]
        out[q, 4] = out[q, 2] * terms[q, 4]
    return out


@kernel
def eliminate_lines(
    roots: FloatArray, weights: FloatArray, scan_of: Int32Array, patch_of: Int32Array, sums: FloatArray, own: FloatArray,
    columns: Float32Array, rhs: FloatArray,
) -> None:  # fmt: skip
    """Schur complement of `wall_patches.group_sums`, times the ``weights`` (Q,) of their patches, by the patches' lines
    (`line_roots` of what they weigh), factorised.

    Fills ``columns`` (M, 3, 2) of the groups, adds to ``own`` (K, 3, 3) and the right-hand side (K, 3): the information
    of poses k and l is [k = l] own_k less, over the patches, the sum of column_kq column_lq^T.
    """
    for g in range(patch_of.shape[0]):
        q, k = patch_of[g], scan_of[g]
        w = weights[q]
        r0, r1, r2, t0, t1 = roots[q, 0], roots[q, 1], roots[q, 2], roots[q, 3], roots[q, 4]
        for u in range(3):
            c0 = w * (sums[g, 6 + u] * r0 + sums[g, 9 + u] * r1)
            c1 = w * sums[g, 9 + u] * r2
            columns[g, u, 0], columns[g, u, 1] = c0, c1
            if r0 != 0.0:
                rhs[k, u] += w * sums[g, 15 + u] - c0 * t0 - c1 * t1
        if r0 == 0.0:
            continue
        own[k, 0, 0] += w * sums[g, 0]
        own[k, 1, 1] += w * sums[g, 3]
        own[k, 2, 2] += w * sums[g, 5]
        own[k, 0, 1] += w * sums[g, 1]
        own[k, 1, 0] += w * sums[g, 1]
        own[k, 0, 2] += w * sums[g, 2]
        own[k, 2, 0] += w * sums[g, 2]
        own[k, 1, 2] += w * sums[g, 4]
        own[k, 2, 1] += w * sums[g, 4]


@kernel
def add_wall_product(
    own: FloatArray, columns: Float32Array, scan_of: Int32Array, patch_of: Int32Array, x: FloatArray, seen: FloatArray,
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
    own: FloatArray, columns: Float32Array, scan_of: Int32Array, patch_of: Int32Array, patches: int, size: int,
    carried: FloatArray, coarse_of: IntArray, within: FloatArray,
) -> tuple[FloatArray, FloatArray, Int32Array, Int32Array]:  # fmt: skip
    """The same matrix on two levels, as `half_matrix.add_stretches`.

    Adds the diagonal blocks of each stretch of ``size`` poses to ``within``. Returns the matrix of the coarse unknowns in the
    form of this one: own, columns, and coarse unknown and patch of each.
    """
    groups, scans = patch_of.shape[0], own.shape[0]
    coarse_own = np.zeros((coarse_of[scans - 1] + 1, 3, 3))
    # the stretch in which each patch was seen last, and its coarse column there; groups by patch, a linked list
    latest, slot = np.full(patches, -1, np.int64), np.empty(patches, np.int64)
    newest, older = np.full(patches, -1, np.int64), np.empty(groups, np.int32)
    count = 0
    for g in range(groups):
        c, q = coarse_of[scan_of[g]], patch_of[g]
        if latest[q] != c:
            latest[q] = c
            count += 1
    coarse_columns = np.zeros((count, 3, 2))
    coarse_scan, coarse_patch = np.empty(count, np.int32), np.empty(count, np.int32)
    for q in range(patches):
        latest[q] = -1
    count = 0
    for g in range(groups):
        k, q = scan_of[g], patch_of[g]
        older[g] = newest[q]
        newest[q] = g
        if latest[q] != coarse_of[k]:
            latest[q], slot[q] = coarse_of[k], count
            coarse_scan[count], coarse_patch[count] = coarse_of[k], q
            count += 1
        at = slot[q]
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
                a0, a1 = np.float64(columns[g, u, 0]), np.float64(columns[g, u, 1])
                for v in range(3):
                    term = a0 * columns[h, v, 0] + a1 * columns[h, v, 1]
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
    return coarse_own, coarse_columns, coarse_scan, coarse_patch


@kernel
def wall_blocks(
    own: FloatArray, columns: FloatArray, scan_of: Int32Array, patch_of: Int32Array, patches: int
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
                    a0, a1 = np.float64(columns[g, u, 0]), np.float64(columns[g, u, 1])
                    for v in range(3):
                        blocks[b, u, v] -= a0 * columns[h, v, 0] + a1 * columns[h, v, 1]
    return first, column, blocks
