"""How low chi2 of a pose graph can be at all: a bound by duality, after SE-Sync.

chi2 is replaced by a quadratic form x^H Q x in unit headings z and positions t that is nowhere above it and touches it at
the solution (`minorant`). At a minimum of the form let Lambda = Re(conj(z) (Q x)_z). If S = Q - diag(Lambda, 0) has no
negative eigenvalue, sum(Lambda) is the least value of the form over all poses (Rosen et al., SE-Sync, IJRR 2019, theorem 7),
and with the constant a bound on chi2. If S + epsilon is positive definite over the headings, the bound is lower by epsilon per
heading. Definiteness is shown by an L D L^H in double precision.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import block_array, csc_array, diags_array

from mfslam.graph.chordal import ComplexArray, QuadraticForm, order_of_free_poses
from mfslam.graph.minorant import minorant
from mfslam.graph.symmetric_factors import SymmetricFactors
from mfslam.pose_graphs.data import Problem
from mfslam.types import FloatArray, IntArray

TOLERANCE = 1e-3  # relative: a solution this near to the bound is called the global optimum
_NOTHING = 1e-6  # chi2 of a graph without contradictions
_STEPS = 20
_EXACT = 1e-7  # of chi2: what the bound may lose by a minimum that is not quite reached
_EPSILONS = 1e-6, 1e-4, 1e-2, 1.0, 1e2  # of chi2 per heading


@dataclass(frozen=True, slots=True)
class Certificate:
    """``lower_bound``: no poses have a chi2 below it. ``certified``: the solution's is within `TOLERANCE`."""

    certified: bool
    chi2: float
    lower_bound: float | None
    reason: str

    @property
    def gap(self) -> float | None:
        """Share of chi2 by which the solution could be improved at most."""
        if self.lower_bound is None:
            return None
        return max(0.0, self.chi2 - self.lower_bound) / max(self.chi2, _NOTHING)

    def as_json(self) -> dict[str, Any]:
        return {
            "certified": self.certified,
            "lower_bound": self.lower_bound,
            "relative_gap": self.gap,
            "reason": self.reason,
        }


def certify(problem: Problem, world_T_pose: FloatArray) -> Certificate:
    """Whether poses (N, 3), a solution of the graph, are its global optimum."""
    chi2 = float(problem.chi2(world_T_pose).sum())
    below = minorant(problem, world_T_pose)
    if below is None:
        return Certificate(False, chi2, None, "an edge is half a turn off")
    form = below.form
    if form.headings == 1:
        return Certificate(True, chi2, chi2, "nothing is free to move")
    order = order_of_free_poses(problem)
    x = _minimise(form, form.unknowns(world_T_pose), order, _EXACT * max(chi2, _NOTHING))
    bound, is_positive = _bound(form, x, order, chi2)
    lower = float(np.clip(bound + below.constant, 0.0, chi2))  # above chi2 it is so by rounding
    if chi2 - lower <= max(TOLERANCE * chi2, _NOTHING):
        return Certificate(True, chi2, lower, "no poses have a lower chi2 than the bound")
    if not below.is_plain:
        reason = "edges know far less in one direction than in another, which leaves the bound loose"
    elif is_positive:
        reason = "headings far from their measurements leave the bound loose"
    else:
        reason = "the dual matrix has a negative eigenvalue: a better optimum may exist"
    return Certificate(False, chi2, lower, reason)


def _minimise(form: QuadraticForm, x: ComplexArray, order: IntArray, exact: float) -> ComplexArray:
    """The form's minimum near x with headings of length one, by Newton's method, as far as it goes: the
    bound holds at any x, and is tight at the minimum."""
    z = form.headings
    steps = np.concatenate([order, z - 1 + order, 2 * z - 2 + order]).reshape(3, -1).T.ravel()
    last = np.inf
    for _ in range(_STEPS):
        qx = np.asarray(form.q @ x)
        if last < np.inf and abs(np.vdot(x[z:], qx[z:]).real) < exact:
            break
        # directions: each free heading along its circle, each position in x and in y
        move = block_array(
            [[diags_array(1j * x[: z - 1]), None, None], [csc_array((1, z - 1), dtype=complex), None, None],
             [None, diags_array(np.ones(z - 1)), diags_array(np.full(z - 1, 1j))]], format="csc",
        )  # fmt: skip
        hessian = csc_array((move.conj().T @ _dual_matrix(form, x, qx) @ move).real)
        slope = (move.conj().T @ qx).real
        factors = SymmetricFactors(hessian, steps)
        if not factors.is_positive:
            break
        step = -np.asarray(factors.solve(slope), dtype=np.float64)
        del factors, hessian, move  # of a large graph, a gigabyte
        size = float(np.abs(step).max())
        if not size < last:  # nothing but rounding is left, or it leads away
            break
        last = size
        x = np.concatenate(
            [
                x[: z - 1] * np.exp(1j * step[: z - 1]),
                x[z - 1 : z],
                x[z:] + step[z - 1 : 2 * z - 2] + 1j * step[2 * z - 2 :],
            ]
        )
    return x


def _multipliers(form: QuadraticForm, x: ComplexArray, qx: ComplexArray) -> FloatArray:
    out = np.zeros(len(x))
    out[: form.headings] = (x[: form.headings].conj() * qx[: form.headings]).real
    return out


def _dual_matrix(form: QuadraticForm, x: ComplexArray, qx: ComplexArray, epsilon: float = 0.0) -> csc_array:
    """S = Q - diag(Lambda, 0), with epsilon added on the headings."""
    shift = -_multipliers(form, x, qx)
    shift[: form.headings] += epsilon
    return csc_array(form.q + diags_array(shift, format="csc"))


def _bound(form: QuadraticForm, x: ComplexArray, order: IntArray, chi2: float) -> tuple[float, bool]:
    """Lower bound of the form over all poses, and whether S is positive semidefinite but for rounding."""
    z = form.headings
    qx = np.asarray(form.q @ x)
    total = float(_multipliers(form, x, qx).sum())
    unknowns = np.append(np.column_stack([order, z + order]).ravel(), z - 1)  # the world last
    for epsilon in np.array(_EPSILONS) * max(chi2, _NOTHING) / z:
        if SymmetricFactors(_dual_matrix(form, x, qx, epsilon), unknowns).is_positive:
            return total - epsilon * z, bool(epsilon * z <= _EPSILONS[1] * max(chi2, _NOTHING))
    return -np.inf, False
