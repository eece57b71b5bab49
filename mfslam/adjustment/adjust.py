"""The adjustment: walls as unknown lines that are eliminated, poses and wheel errors by Gauss-Newton.

A patch of wall that m scans saw says how those m scans stand to one another, and each beam says it once: unlike
a graph of scan pairs, in which the noise of one scan enters with every pair that it is part of. (A bundle
adjustment; for planes: Kaess 2015; Liu and Zhang 2021.)
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mfslam import icp, se2
from mfslam.adjustment.equations import Equations, Solver
from mfslam.adjustment.walls import Walls
from mfslam.adjustment.wheels import WheelTerms, between_jacobians
from mfslam.kernels import partners, wall_patches, wall_terms
from mfslam.kernels.poses import transform_points
from mfslam.types import DeskewedScan, Edge, FloatArray, IntArray

SETTLED_M, STALLED = 0.0015, 0.95  # change over SPAN keyframes (RMS), and against that before
SPAN = 50
PROBE_ITERATIONS = 2  # iterations in which the wheels' noise is looked at closely
PATCH_M, PATCH_KERNELS = 0.25, 3.0  # length of a patch, and at least so many scales of the kernel
FACING_COS = 0.7  # a point faces as its patch does, within 45 deg
MIN_SCANS = 5  # that saw a patch, for it to tell of their noise
KERNEL_SIGMAS, NARROWING = 3.0, 0.5  # of the Geman-McClure kernel on points; its scale from turn to turn
LOOP_KERNEL_SIGMAS = 3.0  # of the Cauchy kernel on other edges
MEDIAN_CHI2 = 0.455  # of a squared normal error
LEAST_SIGMA_M, LARGEST_SIGMA_M = 0.001, 0.05
PRIOR_POINTS = 100.0  # that the configured noise of a range counts as


@dataclass(frozen=True)
class Noise:
    """``range_sigma_m``: of one range. ``patch_sigma_m``: what the points of a scan on one patch have in common:
    rough walls, a motion within the scan that is not quite right."""

    range_sigma_m: float
    patch_sigma_m: float


@dataclass(frozen=True, eq=False)
class Adjusted:
    """``world_T_body`` (K, 3); ``solver``: holds the information of right perturbations of the poses, three each, then
    of the wheels' errors, the first pose being held; ``noise`` as found."""

    world_T_body: FloatArray
    solver: Solver
    noise: Noise


@dataclass(frozen=True, eq=False)
class _Points:
    """Of all scans, one after the other: ``points_m``, ``normals`` (P, 2) in the frame of their scan, rows
    ``first`` (K + 1,), and the lasers (K, 2) in those frames."""

    points_m: FloatArray
    normals: FloatArray
    first: IntArray
    origins_m: FloatArray


@dataclass(frozen=True, eq=False)
class _Residuals:
    """Of each group its patch (M,) and the last four of its sums (M, 4): see `wall_patches.group_sums`."""

    patch_of: IntArray
    sums: FloatArray
    patch_count: int


def adjust(
    clouds: Sequence[DeskewedScan],
    origins_m: FloatArray,
    world_T_body: FloatArray,
    edges: Sequence[Edge],
    wheels: WheelTerms,
    noise: Noise,
    iterations: int,
    gate_m: float,
) -> Adjusted:
    """Adjust keyframes (K) from where they stand.

    ``origins_m`` (K, 2): the laser in the body frame. ``edges``: whatever else ties keyframes. ``gate_m``: scale
    of the kernel on points in the first iteration. ``wheels`` learns their errors and noise, in place.
    """
    points = _Points(
        np.concatenate([cloud.points_m for cloud in clouds]),
        np.concatenate([cloud.normals for cloud in clouds]),
        np.cumsum([0, *(len(cloud.points_m) for cloud in clouds)], dtype=np.int64),
        origins_m,
    )
    poses = world_T_body.copy()
    count = len(poses)
    unknowns = count + len(wheels.errors)
    solver, change_before_m = Solver(poses, unknowns - count), math.inf
    least_kernel_m = KERNEL_SIGMAS * math.hypot(noise.range_sigma_m, noise.patch_sigma_m)
    for iteration in range(iterations):
        # wide at first, so that walls that are far from each other still pull
        kernel_m = max(least_kernel_m, gate_m * NARROWING**iteration)
        solver.forget()  # two of these systems need not lie in memory
        walls, rhs, residuals = _wall_equations(points, poses, kernel_m, noise)
        equations = Equations(unknowns)
        equations.rhs[:count] += rhs
        wheels.add_to(equations.add, poses, count)
        _add_edges(equations, edges, poses)
        equations.hold(0)
        solver.take([walls, equations.matrix()])
        step = solver.solve(equations.rhs.reshape(-1, 1)).reshape(-1, 3)
        moved = se2.compose(poses, se2.exp(step[:count]))
        change_m = _change_m(poses, moved)
        poses = moved
        wheels.errors = wheels.errors + step[count:]
        wheels.learn_noise(poses, solver, unknowns, probe=iteration < PROBE_ITERATIONS)
        if change_m < SETTLED_M or change_m > STALLED * change_before_m:
            break
        change_before_m = change_m
    return Adjusted(poses, solver, _noise_found(residuals, count, noise, kernel_m))


def _change_m(before: FloatArray, after: FloatArray) -> float:
    """By how much (RMS) the way over SPAN keyframes has changed: what holds a whole log in place may be so weak
    that it never settles."""
    span = min(SPAN, len(before) - 1)
    change = se2.between(se2.between(before[:-span], before[span:]), se2.between(after[:-span], after[span:]))
    return float(np.sqrt(np.mean(change[:, :2] ** 2)))


def _patches(
    points: _Points, poses: FloatArray, kernel_m: float, noise: Noise
) -> tuple[FloatArray, IntArray]:
    """Lines (S, 5) of the patches as the scans stand, and the patch (P,) of every point."""
    oriented = np.empty((len(points.points_m), 4))
    for k, pose in enumerate(poses):
        rows = slice(points.first[k], points.first[k + 1])
        transform_points(pose, points.points_m[rows], points.normals[rows], oriented[rows])
    # long at first: two passes by one wall have patches of their own where they stand half a patch apart
    length_m = max(PATCH_M, PATCH_KERNELS * kernel_m)
    table = icp.reference_table(
        wall_patches.seed_patches(icp.reference_table(oriented), icp.CELL_M, length_m)
    )
    count = len(table[1])
    patch, seen = partners.nothing_known(len(oriented))
    partners.find_partners(*table, icp.CELL_M, oriented, length_m, FACING_COS, patch, seen)
    patch[~points.normals.any(axis=1)] = -1
    lines = np.empty((0, 5))
    for _ in range(3):
        lines = wall_patches.fit_patches(count, points.points_m, points.first, poses, patch, lines, kernel_m)
    # what is no line, such as a corner or a crowd, says nothing
    straight = (lines[:, 4] >= 0.0) & (lines[:, 4] < (3.0 * noise.range_sigma_m) ** 2 + (0.5 * kernel_m) ** 2)
    on = np.flatnonzero(patch >= 0)
    patch[on[~straight[patch[on]]]] = -1
    return lines, patch


def _wall_equations(
    points: _Points, poses: FloatArray, kernel_m: float, noise: Noise
) -> tuple[Walls, FloatArray, _Residuals]:
    """What the walls say of the poses: information, right-hand side (K, 3), and what is left of the points."""
    lines, patch = _patches(points, poses, kernel_m, noise)
    scan_of, patch_of, sums = wall_patches.group_sums(
        points.points_m, points.origins_m, points.normals, points.first, poses, patch, lines,
        noise.range_sigma_m, noise.patch_sigma_m, kernel_m,
    )  # fmt: skip
    own, columns, rhs = wall_terms.eliminate_lines(len(poses), len(lines), scan_of, patch_of, sums)
    residuals = _Residuals(patch_of, sums[:, 20:24].copy(), len(lines))
    return Walls(own, columns, scan_of, patch_of, len(lines)), rhs, residuals


def _add_edges(equations: Equations, edges: Sequence[Edge], poses: FloatArray) -> None:
    """Edges between keyframes, robustly; unary ones (compass) too."""
    if not edges:
        return
    i, j = np.array([(e.i, e.j) for e in edges], dtype=np.int64).T
    measured, information = np.array([e.i_T_j for e in edges]), np.array([e.information for e in edges])
    both = i != j
    at = np.where(both[:, None], se2.between(poses[i], poses[j]), poses[j])
    error = se2.log(se2.between(measured, at))
    chi2 = np.einsum("na,nab,nb->n", error, information, error)
    information = information / (1.0 + chi2 / LOOP_KERNEL_SIGMAS**2)[:, None, None]
    before, after = between_jacobians(at)
    equations.add([(i, before * both[:, None, None]), (j, after)], error, information)


def _noise_found(residuals: _Residuals, scan_count: int, noise: Noise, kernel_m: float) -> Noise:
    """The noise that the residuals show, under a kernel of scale ``kernel_m``: of ranges within the groups, of patches
    between them."""
    patch_of, patch_count = residuals.patch_of, residuals.patch_count
    seen_by = np.bincount(patch_of, minlength=patch_count)
    size, total, squares, slant = residuals.sums[seen_by[patch_of] >= MIN_SCANS].T
    if not len(size):
        return noise
    within = size > 1.5
    free = np.sum((slant * (1.0 - 1.0 / np.maximum(size, 1.0)))[within])
    spread = np.sum((squares - total**2 / size)[within])
    whole = math.hypot(noise.range_sigma_m, noise.patch_sigma_m)
    for _ in range(5):  # the kernel makes what is left look smaller, by how much depends on how large it is
        spread_of_all = spread / _kept_by_kernel(kernel_m / whole)
        range_variance = (PRIOR_POINTS * noise.range_sigma_m**2 + spread_of_all) / (PRIOR_POINTS + free)
        whole = math.sqrt(range_variance + noise.patch_sigma_m**2)
    mean = total / size
    left = 1.0 - (3.0 * scan_count + 2.0 * patch_count) / max(len(patch_of), 1)
    low, high = LEAST_SIGMA_M, LARGEST_SIGMA_M
    for _ in range(20):
        middle = 0.5 * (low + high)
        chi2 = np.median(mean**2 / (range_variance * slant / size**2 + middle**2))
        low, high = (middle, high) if chi2 > MEDIAN_CHI2 * max(left, 0.1) else (low, middle)
    return Noise(float(np.sqrt(range_variance)), float(high))


def _kept_by_kernel(scale_sigmas: float) -> float:
    """Variance of normal errors under the weights of a Geman-McClure kernel, over their variance."""
    x = np.linspace(0.0, 6.0, 601)
    weight = (scale_sigmas**2 / (scale_sigmas**2 + x**2)) ** 2 * np.exp(-0.5 * x**2)
    return float(np.sum(weight * x**2) / np.sum(weight))
