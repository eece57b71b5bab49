"""What the walls say of the poses: patches of wall sought, their lines fitted and eliminated."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mfslam import icp
from mfslam.adjustment.noise import MIN_SCANS, Noise, Residuals
from mfslam.adjustment.points import ScanPoints
from mfslam.adjustment.walls import Walls
from mfslam.kernels import partners, wall_patches, wall_terms
from mfslam.kernels.cells import CellTable
from mfslam.types import FloatArray, Int32Array

PATCH_M, PATCH_KERNELS = 0.25, 3.0  # length of a patch, and at least so many scales of the kernel
FACING_COS = 0.7  # a point faces as its patch does, within 45 deg
DISAGREE = 2.0  # the scans that saw a patch, where their chi2 is above that many times the usual one

_Groups = tuple[Int32Array, Int32Array, FloatArray]


def wall_equations(
    points: ScanPoints, poses: FloatArray, kernel_m: float, noise: Noise
) -> tuple[Walls, FloatArray, Residuals]:
    """What the walls say of poses (K, 3): information, right-hand side (K, 3), and what is left of the points."""
    return equations_of(points, poses, *find_patches(points, poses, kernel_m, noise), kernel_m, noise)


def equations_of(
    points: ScanPoints, poses: FloatArray, lines: FloatArray, patch: Int32Array, kernel_m: float, noise: Noise
) -> tuple[Walls, FloatArray, Residuals]:
    """The same, of patches that were found before."""
    chunks, kept = points.chunks(), list[_Groups]()

    def groups() -> Iterator[_Groups]:
        for scans in chunks:
            yield _groups(points, poses, scans, patch, lines, kernel_m, noise)

    # the sums of all groups of a long log would not be small: they are made anew for the second look at them
    terms, count = np.zeros((len(lines), 7)), 0
    for found in groups():
        wall_terms.add_line_terms(found[1], found[2], terms)
        count += len(found[1])
        kept = [found] if len(chunks) == 1 else []
    weights = disagreement_weights(terms)
    roots = wall_terms.line_roots(np.append(weights[:, None] * terms[:, :5], terms[:, 5:], axis=1))
    own, rhs = np.zeros((len(poses), 3, 3)), np.zeros((len(poses), 3))
    columns, left = np.empty((count, 3, 2), np.float32), np.empty((count, 4), np.float32)
    scan_of, patch_of, n = np.empty(count, np.int32), np.empty(count, np.int32), 0
    for scans, patches, sums in kept or groups():
        rows = slice(n, n + len(scans))
        wall_terms.eliminate_lines(roots, weights, scans, patches, sums, own, columns[rows], rhs)
        scan_of[rows], patch_of[rows], left[rows] = scans, patches, sums[:, 20:24]
        n = rows.stop
    return Walls(own, columns, scan_of, patch_of, len(lines)), rhs, Residuals(patch_of, left, len(lines))


def disagreement_weights(terms: FloatArray) -> FloatArray:
    """(Q,) of patches with ``terms`` (Q, 7): less than 1 where scans disagree far more than usual: what they saw has moved."""
    scans, chi2 = terms[:, 5], terms[:, 6]
    told = scans >= MIN_SCANS
    if not told.any():
        return np.ones(len(terms))
    usual = max(float(np.median(chi2[told] / scans[told])), 1e-12)
    return np.asarray(np.minimum(1.0, DISAGREE * usual * scans / np.maximum(chi2, 1e-12)) ** 2)


def _groups(
    points: ScanPoints, poses: FloatArray, scans: slice, patch: Int32Array, lines: FloatArray, kernel_m: float,
    noise: Noise,
) -> _Groups:  # fmt: skip
    """Scan, patch and sums of the groups of some scans."""
    scan_of, patch_of, sums = wall_patches.group_sums(
        points.points_m, points.origins_m[scans], points.spare_m, points.normals, points.first[scans.start : scans.stop + 1],
        poses[scans], patch, lines, noise.range_sigma_m, noise.patch_sigma_m, kernel_m,
    )  # fmt: skip
    scan_of += scans.start
    return scan_of, patch_of, sums


def find_patches(
    points: ScanPoints, poses: FloatArray, kernel_m: float, noise: Noise
) -> tuple[FloatArray, Int32Array]:
    """Lines (S, 5) of the patches as the scans stand, and the patch (P,) of every point, -1: none."""
    # long at first: two passes by one wall have patches of their own where they stand half a patch apart
    length_m = max(PATCH_M, PATCH_KERNELS * kernel_m)
    seeds = _seeds(points, poses, length_m)
    patch = np.empty(len(points.points_m), np.int32)
    for scans in points.chunks():
        placed = points.placed(poses, scans)
        nearest, seen = partners.nothing_known(len(placed))
        partners.find_partners(*seeds, icp.CELL_M, placed, length_m, FACING_COS, nearest, seen)
        rows = slice(points.first[scans.start], points.first[scans.stop])
        patch[rows] = np.where(placed[:, 2:].any(axis=1), nearest, -1)
    lines = np.empty((0, 5))
    for _ in range(3):
        lines = wall_patches.fit_patches(
            len(seeds[1]), points.points_m, points.first, poses, patch, lines, kernel_m
        )
    # what is no line, such as a corner or a crowd, says nothing
    straight = (lines[:, 4] >= 0.0) & (lines[:, 4] < (0.5 * kernel_m) ** 2)
    number = np.where(np.append(straight, False), np.arange(len(lines) + 1, dtype=np.int32), np.int32(-1))
    return lines, number[patch]


def _seeds(points: ScanPoints, poses: FloatArray, length_m: float) -> CellTable:
    """About where the patches are: on long logs, of the seeds of some scans at a time."""
    found = [
        wall_patches.seed_patches(icp.reference_table(points.placed(poses, scans)), icp.CELL_M, length_m)
        for scans in points.chunks()
    ]
    if len(found) > 1:
        found = [wall_patches.seed_patches(icp.reference_table(np.concatenate(found)), icp.CELL_M, length_m)]
    return icp.reference_table(found[0])
