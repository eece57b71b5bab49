"""How low chi2 of a pose graph can be at all: a bound by duality, after SE-Sync.

Every edge's cost is replaced by one that is nowhere above it, touches it (but for a term of fourth order) at
the solution, and is a quadratic form in unit complex headings z and complex positions t. With e the error of
the heading, e0 the one at the solution and Omega >= diag(tau, tau, kappa):

    e^2 >= e0^2 + 2 e0 / sin(e0) (cos e0 - cos e)                   (equal at e = +-e0)
    |log translation|^2 >= |translation|^2                          (equal at e = 0)

so the form has the weights tau and kappa e0 / sin(e0), and a constant. At a minimum of the form let
Lambda = Re(conj(z) (Q x)_z). If S = Q - diag(Lambda, 0) has no negative eigenvalue, sum(Lambda) is the least value of
the form over all poses (Rosen et al., SE-Sync, IJRR 2019, theorem 7), and with the constant a bound on chi2.
If S + epsilon is positive definite over the headings, the bound is lower by epsilon per heading.
Definiteness is shown by an L D L^H in double precision.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import block_array, csc_array, diags_array

from mfslam.pose_graphs.chordal import (
    ComplexArray,
    QuadraticForm,
    add_diagonal,
    factorise,
    isotropic_part,
    quadratic_form,
)
from mfslam.pose_graphs.data import Problem
from mfslam.types import FloatArray

TOLERANCE = 1e-3  # relative: a solution this near to the bound is called the global optimum
_NOTHING = 1e-6  # chi2 of a graph without contradictions
_STEPS = 20


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
    tau, kappa = isotropic_part(problem.information)
    error = problem.residuals(world_T_pose)[:, 2]
    sine = np.where(error == 0, 1.0, np.sinc(error / np.pi))
    if (sine <= 0).any():
        return Certificate(False, chi2, None, "an edge is half a turn off")
    constant = float(np.sum(kappa * (error**2 - 2.0 / sine * (1.0 - np.cos(error)))))
    form = quadratic_form(problem, tau, kappa / sine)
    if form.headings == 1:
        return Certificate(True, chi2, chi2, "nothing is free to move")
    x = _minimise(form, form.unknowns(world_T_pose))
    bound, psd = _bound(form, x, chi2)
    lower = max(0.0, bound + constant)
    if chi2 - lower <= max(TOLERANCE * chi2, _NOTHING):
        return Certificate(True, chi2, lower, "no poses have a lower chi2 than the bound")
    plain = np.allclose(tau, problem.information[:, 0, 0]) and np.allclose(
        kappa, problem.information[:, 2, 2]
    )
    if not plain:
        reason = "errors weigh differently by direction, and the bound holds for the least weight only"
    elif psd:
        reason = "headings far from their measurements leave the bound loose"
    else:
        reason = "the dual matrix has a negative eigenvalue: a better optimum may exist"
    return Certificate(False, chi2, lower, reason)


def _minimise(form: QuadraticForm, x: ComplexArray) -> ComplexArray:
    """The form's minimum near x with headings of length one, by Newton's method, as far as it goes: the
    bound holds at any x, and is tight at the minimum."""
    z = form.headings
    last = np.inf
    for _ in range(_STEPS):
        s, gradient = _dual_matrix(form, x)
        # directions: each free heading along its circle, each position in x and in y
        turn = 1j * x[: z - 1]
        move = block_array(
            [[diags_array(turn), None, None], [csc_array((1, z - 1), dtype=complex), None, None],
             [None, diags_array(np.ones(z - 1)), diags_array(np.full(z - 1, 1j))]], format="csc",
        )  # fmt: skip
        hessian = csc_array((move.conj().T @ s @ move).real)
        slope = (move.conj().T @ gradient).real
        factors = factorise(hessian)
        if factors is None or (factors.U.diagonal() <= 0).any():
            break
        step = -factors.solve(slope)
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
        if size < 1e-9 * float(np.abs(x).max()):
            break
    return x


def _dual_matrix(form: QuadraticForm, x: ComplexArray) -> tuple[csc_array, ComplexArray]:
    """S = Q - diag(Lambda, 0), and Q x."""
    qx = np.asarray(form.q @ x)
    return add_diagonal(form.q, -_multipliers(form, x, qx)), qx


def _multipliers(form: QuadraticForm, x: ComplexArray, qx: ComplexArray) -> FloatArray:
    out = np.zeros(len(x))
    out[: form.headings] = (x[: form.headings].conj() * qx[: form.headings]).real
    return out


def _bound(form: QuadraticForm, x: ComplexArray, chi2: float) -> tuple[float, bool]:
    """Lower bound of the form over all poses, and whether S is positive semidefinite but for rounding."""
    z = form.headings
    qx = np.asarray(form.q @ x)
    multipliers = _multipliers(form, x, qx)
    s = add_diagonal(form.q, -multipliers)
    ones = np.concatenate([np.ones(z), np.zeros(len(x) - z)])
    total = float(multipliers.sum())
    small = 1e-6 * max(chi2, _NOTHING) / z
    for epsilon in small * 10.0 ** np.arange(8):
        factors = factorise(add_diagonal(s, epsilon * ones))
        if factors is not None and (factors.U.diagonal() > 0).all():
            return total - epsilon * z, bool(epsilon <= 1e2 * small)
    return -np.inf, False
