"""The errors of ranges, poses and walls as unknowns of one least-squares problem: see `range_errors`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import null_space
from scipy.sparse import csr_matrix

from mfslam import se2
from mfslam.adjustment import Noise, ScanPoints
from mfslam.adjustment.equations import Equations, Solver
from mfslam.adjustment.noise import noise_found
from mfslam.adjustment.wall_equations import equations_of, find_patches
from mfslam.adjustment.wheels import between_jacobians
from mfslam.kernels.wall_patches import LIMIT_SIGMAS
from mfslam.types import BoolArray, Float32Array, FloatArray, Int32Array, IntArray

PRIOR_M, ALIKE_M = 0.03, 0.5  # of an error, one sigma; errors of ranges nearer than this are alike
UNLIKE_SHARE = 1e-4  # of the prior's variance, each knot for itself: so that it has an inverse
KERNEL_SIGMAS = 3.0  # of the Geman-McClure kernel on points
SOLVED = 1e-3
TIES = np.eye(3)  # 1 m, 1 rad between successive poses: only so that nothing falls apart


@dataclass(frozen=True, eq=False)
class RangeState:
    """``world_T_body`` (K, 3), ``errors_m`` of ranges at the knots (N,) and their ``covariance`` (N, N)."""

    world_T_body: FloatArray
    errors_m: FloatArray
    covariance: FloatArray
    noise: Noise


@dataclass(frozen=True, eq=False)
class _Terms:
    """Of each point (P,): its residual, its weight, and how the residual changes with the pose of its scan (P, 3), the offset and
    turn of its line (P, 2), and its range."""

    residual: FloatArray
    weight: FloatArray
    by_pose: FloatArray
    by_line: FloatArray
    by_range: FloatArray


class RangeProblem:
    """Points of K scans with ranges as told (P,), whose errors are sought at ``knots_m`` (N,), evenly apart and from 0.

    Errors that grow in proportion to the range are those of a larger world, and with the same error at all ranges the walls
    hardly disagree: of the errors a straight line over the ranges, as often as they occur, is left out.
    """

    def __init__(self, points: ScanPoints, ranges_m: FloatArray, knots_m: FloatArray) -> None:
        self.points, self.knots_m = points, knots_m
        self._scan_of = np.repeat(np.arange(len(points.origins_m)), np.diff(points.first))
        beams = points.points_m - points.origins_m[self._scan_of]
        self._along = beams / np.linalg.norm(beams, axis=1)[:, None]
        self._ranges_m = ranges_m
        alike = np.exp(-0.5 * ((knots_m[:, None] - knots_m) / ALIKE_M) ** 2)
        self._prior = np.linalg.inv(PRIOR_M**2 * (alike + UNLIKE_SHARE * np.eye(len(knots_m))))
        self._free: FloatArray | None = None  # (N, N - 2): errors without a straight line

    def start(self, world_T_body: FloatArray, noise: Noise) -> RangeState:
        count = len(self.knots_m)
        return RangeState(world_T_body, np.zeros(count), np.zeros((count, count)), noise)

    def improved(self, state: RangeState) -> RangeState:
        """One step of Gauss-Newton."""
        noise, poses, count = state.noise, state.world_T_body, len(state.world_T_body)
        shift_m = np.interp(self._ranges_m, self.knots_m, state.errors_m)
        points = replace(self.points, points_m=self.points.points_m - self._along * shift_m[:, None])
        kernel_m = KERNEL_SIGMAS * float(np.hypot(noise.range_sigma_m, noise.patch_sigma_m))
        lines, patch = find_patches(points, poses, kernel_m, noise)
        walls, rhs, residuals = equations_of(points, poses, lines, patch, kernel_m, noise)
        equations = Equations(count)
        equations.rhs += rhs
        ahead = np.arange(count - 1)
        jacobians = between_jacobians(se2.between(poses[:-1], poses[1:]))
        ties = np.tile(TIES, (count - 1, 1, 1))
        equations.add(list(zip((ahead, ahead + 1), jacobians, strict=True)), np.zeros((count - 1, 3)), ties)
        equations.hold(0)
        terms = self._terms(points, poses, lines, patch, kernel_m, noise)
        shares = self._shares(terms)
        across, own, pull = self._eliminated(terms, shares, np.maximum(patch, 0), len(lines), count)
        if self._free is None:
            weight = shares.T @ (terms.weight * terms.by_range**2)
            self._free = null_space(np.stack([weight, weight * self.knots_m]))
        solver = Solver(poses, 0)
        solver.take([walls, equations.matrix()])
        solved = solver.solve(np.column_stack([equations.rhs.reshape(-1), across]), SOLVED)
        free, carried = self._free, solved[:, 1:]
        told = _positive(free.T @ (own - across.T @ carried) @ free)
        gradient = pull - across.T @ solved[:, 0] - self._prior @ state.errors_m
        covariance = free @ np.linalg.inv(told + free.T @ self._prior @ free) @ free.T
        change_m = covariance @ gradient
        moved = (solved[:, 0] - carried @ change_m).reshape(-1, 3)
        return RangeState(
            se2.compose(poses, se2.exp(moved)),
            state.errors_m + change_m,
            covariance,
            noise_found(residuals, count, noise, kernel_m),
        )

    def _shares(self, terms: _Terms) -> Any:
        """Sparse (P, N): the knots between which the range of each point lies.

        By where its wall is, not by the range told: those told nearer than any wall is are the ones that noise has made so.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            ranges_m = self._ranges_m + np.where(terms.weight > 0.0, terms.residual / terms.by_range, 0.0)
        at = np.clip(ranges_m / self.knots_m[1], 0.0, len(self.knots_m) - 1.001)
        before = at.astype(np.int64)
        share = at - before
        ends = np.stack([before, before + 1], axis=1)
        return _rows(np.stack([1.0 - share, share], axis=1), ends, len(self.knots_m))

    def _terms(
        self, points: ScanPoints, poses: FloatArray, lines: FloatArray, patch: Int32Array, kernel_m: float, noise: Noise
    ) -> _Terms:  # fmt: skip
        """As in `wall_patches.group_sums`, point by point."""
        line, pose = lines[np.maximum(patch, 0)], poses[self._scan_of]
        offset = (
            se2.compose(pose, np.column_stack([points.points_m, np.zeros(len(patch))]))[:, :2] - line[:, :2]
        )
        r = line[:, 2] * offset[:, 0] + line[:, 3] * offset[:, 1]
        u = line[:, 2] * offset[:, 1] - line[:, 3] * offset[:, 0]
        c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
        j0, j1 = c * line[:, 2] + s * line[:, 3], -s * line[:, 2] + c * line[:, 3]
        j2 = j1 * points.points_m[:, 0] - j0 * points.points_m[:, 1]
        outwards = j0 * self._along[:, 0] + j1 * self._along[:, 1]
        slant = np.sum(self._along * points.normals, axis=1)
        told, size = _seen_again(self._scan_of, patch, len(lines))
        with np.errstate(divide="ignore", invalid="ignore"):
            told &= ~(points.spare_m + r / outwards < LIMIT_SIGMAS * noise.range_sigma_m)
        weight = (kernel_m**2 / (kernel_m**2 + r * r)) ** 2
        weight /= (noise.range_sigma_m * slant) ** 2 + size * noise.patch_sigma_m**2
        return _Terms(
            r,
            np.where(told, weight, 0.0),
            np.stack([j0, j1, j2], axis=1),
            np.stack([-np.ones(len(u)), -u], axis=1),
            -outwards,
        )

    def _eliminated(
        self, terms: _Terms, shares: Any, patch: IntArray, lines: int, scans: int
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """What the errors share with the poses (3 K, N), their own information (N, N) and right-hand side (N,), lines
        eliminated."""
        by_pose = _rows(terms.by_pose, 3 * self._scan_of[:, None] + np.arange(3), 3 * scans)
        by_line = _rows(terms.by_line, 2 * patch[:, None] + np.arange(2), 2 * lines)
        by_error = shares.multiply(terms.by_range[:, None]).tocsr()
        weighted = by_error.multiply(terms.weight[:, None]).tocsr()
        of_lines = by_line.multiply(terms.weight[:, None]).tocsr()
        own = np.zeros((lines, 2, 2))
        for a in range(2):
            for b in range(2):
                products = terms.weight * terms.by_line[:, a] * terms.by_line[:, b]
                own[:, a, b] = np.bincount(patch, products, lines)
        determinant = own[:, 0, 0] * own[:, 1, 1] - own[:, 0, 1] ** 2
        sound = determinant > 1e-9 * own[:, 0, 0] * own[:, 1, 1]
        inverse = np.zeros_like(own)
        inverse[sound] = np.linalg.inv(own[sound])
        shared = (by_line.T @ weighted).toarray()
        carried = (inverse @ shared.reshape(lines, 2, -1)).reshape(2 * lines, -1)
        across = (by_pose.T @ weighted).toarray() - by_pose.T @ (of_lines @ carried)
        information = (by_error.T @ weighted).toarray() - shared.T @ carried
        pull = carried.T @ (of_lines.T @ terms.residual) - weighted.T @ terms.residual
        return across, information, pull


def _rows(values: FloatArray, columns: IntArray, width: int) -> Any:
    """Sparse (P, ``width``): values (P, C) at their columns (P, C)."""
    count, each = values.shape
    return csr_matrix(
        (values.ravel(), columns.ravel(), np.arange(0, count * each + 1, each)), shape=(count, width)
    )


def _positive(matrix: FloatArray) -> FloatArray:
    """An information matrix without what rounding has made of directions of which nothing is told."""
    values, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T))
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)


def _seen_again(scan_of: IntArray, patch: Int32Array, patches: int) -> tuple[BoolArray, IntArray]:
    """Of each point whether its patch was seen by two scans at least, and how many points of its scan lie on it."""
    at = np.maximum(patch, 0)
    found, which, size = np.unique(
        np.where(patch >= 0, scan_of * patches + at, -1), return_inverse=True, return_counts=True
    )
    seen_by = np.bincount(found[found >= 0] % patches, minlength=patches)
    return (patch >= 0) & (seen_by[at] >= 2), size[which]


def scan_points(points: ScanPoints, ranges_m: Sequence[Float32Array]) -> FloatArray:
    """Ranges as told of all points (P,); ``ranges_m``: of all beams of each scan."""
    return np.concatenate([ranges[points.scan(k).beams] for k, ranges in enumerate(ranges_m)]).astype(
        np.float64
    )
