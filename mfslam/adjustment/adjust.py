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

from mfslam import se2
from mfslam.adjustment.equations import Equations, Solver
from mfslam.adjustment.noise import Noise, far_off_m, noise_found
from mfslam.adjustment.points import ScanPoints
from mfslam.adjustment.wall_equations import wall_equations
from mfslam.adjustment.wheels import WheelTerms, between_jacobians
from mfslam.types import Edge, FloatArray

SETTLED_M, STALLED = 0.0015, 0.95  # change over SPAN keyframes (RMS), and against that before
SPAN = 50
PROBE_ITERATIONS = 2  # iterations in which the wheels' noise is looked at closely
KERNEL_SIGMAS, NARROWING = 3.0, 0.5  # of the Geman-McClure kernel on points; its scale from turn to turn
WIDE = 5.0  # at first, over how far off scans are that are far off
STEP_ERROR = 0.01  # of a step, relative: finding lines and weights anew after it changes more
LOOP_KERNEL_SIGMAS = 3.0  # of the Cauchy kernel on other edges


@dataclass(frozen=True, eq=False)
class Adjusted:
    """``world_T_body`` (K, 3); ``solver``: holds the information of right perturbations of the poses, three each, then
    of the wheels' errors, the first pose being held; ``noise`` as found."""

    world_T_body: FloatArray
    solver: Solver
    noise: Noise


def adjust(
    points: ScanPoints,
    world_T_body: FloatArray,
    edges: Sequence[Edge],
    wheels: WheelTerms,
    noise: Noise,
    iterations: int,
    gate_m: float,
) -> Adjusted:
    """Adjust keyframes (K) from where they stand.

    ``points``: theirs, deskewed. ``edges``: whatever else ties keyframes. ``gate_m``: scale
    of the kernel on points in the first iteration at most. ``wheels`` learns their errors and noise, in place.
    """
    poses = world_T_body.copy()
    count = len(poses)
    unknowns = count + len(wheels.errors)
    solver, change_before_m = Solver(poses, unknowns - count), math.inf
    # wide at first, so that walls that are far from each other still pull; but no wider than they are: what stands beside
    # a wall is not taken for the wall, and where rooms hold together weakly it takes long to undo that
    gate_m = min(gate_m, WIDE * far_off_m(wall_equations(points, poses, gate_m, noise)[2]))
    least_kernel_m = KERNEL_SIGMAS * math.hypot(noise.range_sigma_m, noise.patch_sigma_m)
    for iteration in range(iterations):
        kernel_m = max(least_kernel_m, gate_m * NARROWING**iteration)
        solver.forget()  # two of these systems need not lie in memory
        walls, rhs, residuals = wall_equations(points, poses, kernel_m, noise)
        equations = Equations(unknowns)
        equations.rhs[:count] += rhs
        wheels.add_to(equations.add, poses, count)
        _add_edges(equations, edges, poses)
        equations.hold(0)
        solver.take([walls, equations.matrix()])
        step = solver.solve(equations.rhs.reshape(-1, 1), STEP_ERROR).reshape(-1, 3)
        moved = se2.compose(poses, se2.exp(step[:count]))
        change_m = _change_m(poses, moved)
        poses = moved
        wheels.errors = wheels.errors + step[count:]
        wheels.learn_noise(poses, solver, unknowns, probe=iteration < PROBE_ITERATIONS)
        if change_m < SETTLED_M or change_m > STALLED * change_before_m:
            break
        change_before_m = change_m
    return Adjusted(poses, solver, noise_found(residuals, count, noise, kernel_m))


def _change_m(before: FloatArray, after: FloatArray) -> float:
    """By how much (RMS) the way over SPAN keyframes has changed: what holds a whole log in place may be so weak
    that it never settles."""
    span = min(SPAN, len(before) - 1)
    change = se2.between(se2.between(before[:-span], before[span:]), se2.between(after[:-span], after[span:]))
    return float(np.sqrt(np.mean(change[:, :2] ** 2)))


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
