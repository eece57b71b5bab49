"""Patches of wall that many scans saw: sought, fitted, and what they say of the poses of those scans."""

import math

import numpy as np

from mfslam.kernels.align import geman_mcclure
from mfslam.kernels.cells import CellTable, cell_key, find_slot
from mfslam.kernels.compiling import kernel
from mfslam.kernels.poses import transform_points
from mfslam.types import Float32Array, FloatArray, Int32Array, IntArray

ALIKE_COS = 0.85  # normals of one patch
SUMS = 24  # of a group: see `group_sums`
LIMIT_SIGMAS = 5.0  # a wall nearer than this to the limit of a range is not seen by all its beams


@kernel
def seed_patches(table: CellTable, cell: float, length: float) -> FloatArray:
    """Oriented points (S, 4), about ``length`` apart, that stand for the surface in a table: each the mean of
    its like-minded neighbours."""
    index, rows = table
    m = rows.shape[0]
    out = np.empty((m, 4))
    taken = np.zeros(m, np.bool_)
    count = 0
    radius = 0.5 * length
    for i in range(m):
        x, y, nx, ny = rows[i, 0], rows[i, 1], rows[i, 2], rows[i, 3]
        if taken[i] or (nx == 0.0 and ny == 0.0):
            continue
        n = 0
        mx = my = sx = sy = 0.0
        for ix in range(math.floor((x - radius) / cell), math.floor((x + radius) / cell) + 1):
            for iy in range(math.floor((y - radius) / cell), math.floor((y + radius) / cell) + 1):
                slot = find_slot(index, cell_key(ix, iy))
                for q in range(index[slot, 1], index[slot, 2]):  # of a free slot: none
                    dx, dy = rows[q, 0] - x, rows[q, 1] - y
                    if dx * dx + dy * dy > radius * radius or nx * rows[q, 2] + ny * rows[q, 3] < ALIKE_COS:
                        continue
                    taken[q] = True
                    n += 1
                    mx += rows[q, 0]
                    my += rows[q, 1]
                    sx += rows[q, 2]
                    sy += rows[q, 3]
        norm = math.sqrt(sx * sx + sy * sy)
        out[count, 0], out[count, 1] = mx / n, my / n
        out[count, 2], out[count, 3] = sx / norm, sy / norm
        count += 1
    return out[:count]


@kernel
def place_scans(
    points: FloatArray, normals: FloatArray, first: IntArray, poses: FloatArray, out: FloatArray
) -> None:
    """Points and normals (P, 2) of scans at ``poses`` (K, 3), those of scan k from row first[k] to first[k + 1], moved into
    the world: rows x, y, nx, ny of ``out``, which begins with those of the first scan."""
    n = 0
    for k in range(poses.shape[0]):
        a, b = first[k], first[k + 1]
        transform_points(poses[k], points[a:b], normals[a:b], out[n : n + b - a])
        n += b - a


@kernel
def fit_patches(
    count: int, points: FloatArray, first: IntArray, poses: FloatArray, patch: Int32Array, lines: FloatArray,
    scale: float,
) -> FloatArray:  # fmt: skip
    """Line (S, 5) through the points of every patch: centre, unit normal, variance across it.

    ``lines``: those found before, for the robust weights of this fit (Geman-McClure of ``scale``, m); with
    no rows all points weigh the same. A patch without points has variance -1.
    """
    sums = np.zeros((count, 6))
    for k in range(poses.shape[0]):
        c, s = math.cos(poses[k, 2]), math.sin(poses[k, 2])
        for i in range(first[k], first[k + 1]):
            q = patch[i]
            if q < 0:
                continue
            x = poses[k, 0] + c * points[i, 0] - s * points[i, 1]
            y = poses[k, 1] + s * points[i, 0] + c * points[i, 1]
            w = 1.0
            if lines.shape[0]:
                r = lines[q, 2] * (x - lines[q, 0]) + lines[q, 3] * (y - lines[q, 1])
                w = geman_mcclure(r, scale)
            sums[q, 0] += w
            sums[q, 1] += w * x
            sums[q, 2] += w * y
            sums[q, 3] += w * x * x
            sums[q, 4] += w * x * y
            sums[q, 5] += w * y * y
    out = np.zeros((count, 5))
    for q in range(count):
        n = sums[q, 0]
        if n <= 0.0:
            out[q, 4] = -1.0
            continue
        mx, my = sums[q, 1] / n, sums[q, 2] / n
        cxx, cxy, cyy = sums[q, 3] / n - mx * mx, sums[q, 4] / n - mx * my, sums[q, 5] / n - my * my
        along = 0.5 * math.atan2(2.0 * cxy, cxx - cyy)
        root = math.sqrt(0.25 * (cxx - cyy) * (cxx - cyy) + cxy * cxy)
        out[q, 0], out[q, 1] = mx, my
        out[q, 2], out[q, 3] = -math.sin(along), math.cos(along)
        out[q, 4] = max(0.0, 0.5 * (cxx + cyy) - root)
    return out


@kernel
def group_sums(
    points: FloatArray, origins: FloatArray, spare: Float32Array, normals: FloatArray, first: IntArray, poses: FloatArray,
    patch: Int32Array, lines: FloatArray, range_sigma: float, patch_sigma: float, kernel_m: float,
) -> tuple[Int32Array, Int32Array, FloatArray]:  # fmt: skip
    """Sums over each group: the points of one scan on one patch.

    The residual of a point is r = n . (T p - q), under a Geman-McClure kernel of scale ``kernel_m``. It varies by the part of ``range_sigma`` across the wall
    and, all of a group alike, by ``patch_sigma``. ``origins`` (K, 2): the laser in the frame of its scan. ``spare`` (P,): by how much
    farther it would have seen. Points on a wall at the limit of its range are left out: those that noise has pushed beyond are
    missing, and the mean of the others is too near.
    With J = dr/d(pose), a right perturbation, and u along the line, the line's own unknowns being its
    offset and its turn, the SUMS columns are: upper triangle of sum w J J^T (6), of w J (-1, -u) offset then
    turn (3 + 3), of the line's block (3), -sum w J r (3), sum w r, sum w u r; and with the kernel's weight k alone sum k,
    sum k r, sum k r^2, sum k slant^2, slant being the part of the range across the wall.
    Returns scan and patch (M,) of each group, in order of scans, and the sums (M, SUMS).
    """
    group = np.full(lines.shape[0], -1, np.int64)
    total = 0
    for k in range(poses.shape[0]):
        for i in range(first[k], first[k + 1]):
            if patch[i] >= 0 and group[patch[i]] != k:
                group[patch[i]] = k
                total += 1
    scan_of, patch_of = np.empty(total, np.int32), np.empty(total, np.int32)
    sums = np.zeros((total, SUMS))
    group[:] = -1
    size = np.zeros(lines.shape[0], np.int64)
    count = 0
    for k in range(poses.shape[0]):
        for i in range(first[k], first[k + 1]):
            if patch[i] >= 0:
                size[patch[i]] = 0
        for i in range(first[k], first[k + 1]):
            if patch[i] >= 0:
                size[patch[i]] += 1
        c, s = math.cos(poses[k, 2]), math.sin(poses[k, 2])
        begin = count
        for i in range(first[k], first[k + 1]):
            q = patch[i]
            if q < 0:
                continue
            px, py = points[i, 0], points[i, 1]
            dx = poses[k, 0] + c * px - s * py - lines[q, 0]
            dy = poses[k, 1] + s * px + c * py - lines[q, 1]
            nx, ny = lines[q, 2], lines[q, 3]
            r, u = nx * dx + ny * dy, -ny * dx + nx * dy
            j0, j1 = c * nx + s * ny, -s * nx + c * ny
            bx, by = px - origins[k, 0], py - origins[k, 1]
            distance = math.sqrt(bx * bx + by * by)
            # by where the wall is, not by the range told: a cut by that only moves the limit
            if spare[i] + r * distance / (j0 * bx + j1 * by) < LIMIT_SIGMAS * range_sigma:
                continue
            slant = max(abs(bx * normals[i, 0] + by * normals[i, 1]), abs(j0 * bx + j1 * by)) / distance
            own = range_sigma * slant
            shared = size[q] * patch_sigma * patch_sigma
            kernel = geman_mcclure(r, kernel_m)
            w = kernel / (own * own + shared)
            j2 = j1 * px - j0 * py
            g = group[q]
            if g < begin or patch_of[g] != q:
                g = count
                count += 1
                group[q] = g
                scan_of[g], patch_of[g] = k, q
            row = sums[g]
            row[0] += w * j0 * j0
            row[1] += w * j0 * j1
            row[2] += w * j0 * j2
            row[3] += w * j1 * j1
            row[4] += w * j1 * j2
            row[5] += w * j2 * j2
            row[6] -= w * j0
            row[7] -= w * j1
            row[8] -= w * j2
            row[9] -= w * j0 * u
            row[10] -= w * j1 * u
            row[11] -= w * j2 * u
            row[12] += w
            row[13] += w * u
            row[14] += w * u * u
            row[15] -= w * j0 * r
            row[16] -= w * j1 * r
            row[17] -= w * j2 * r
            row[18] += w * r
            row[19] += w * u * r
            row[20] += kernel
            row[21] += kernel * r
            row[22] += kernel * r * r
            row[23] += kernel * slant * slant
    return scan_of[:count], patch_of[:count], sums[:count]
