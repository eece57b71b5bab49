"""Pose graphs as a quadratic form, and the start that follows from it by two linear solves.

With headings as unit complex numbers z and positions as complex numbers t, an edge with translation p and
heading w that weighs its errors alike in all directions costs

    tau |t_j - t_i - z_i p|^2 + kappa |z_j - z_i w|^2 = |B x|^2,   x = (z, t)

(Rosen et al., SE-Sync, IJRR 2019, in the plane; Carlone et al., Initialization techniques for 3D SLAM, ICRA 2015).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array, csc_array

from mfslam.graph.symmetric_factors import SymmetricFactors, elimination_order
from mfslam.pose_graphs.data import Problem
from mfslam.types import FloatArray, IntArray

ComplexArray = npt.NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class QuadraticForm:
    """x -> x^H Q x over the unknowns of a graph: F headings of free poses, the world's heading, F positions.

    ``q`` (2F + 1, 2F + 1) Hermitian. Held poses are rigid with the world, whose position is the origin.
    """

    q: csc_array
    free: IntArray

    @property
    def headings(self) -> int:
        """Number of headings, that of the world (the last of them, 1) included."""
        return len(self.free) + 1

    def unknowns(self, world_T_pose: FloatArray) -> ComplexArray:
        poses = world_T_pose[self.free]
        return np.concatenate([np.exp(1j * poses[:, 2]), [1.0], poses[:, 0] + 1j * poses[:, 1]])

    def poses(self, unknowns: ComplexArray, world_T_pose: FloatArray) -> FloatArray:
        """Poses (N, 3) of the unknowns; those that are held come from ``world_T_pose``."""
        z, t = unknowns[: len(self.free)], unknowns[self.headings :]
        out = world_T_pose.copy()
        out[self.free] = np.column_stack([t.real, t.imag, np.angle(z)])
        return out


@dataclass(frozen=True, eq=False)
class Couplings:
    """Terms Re(a conj(z_i) (t_j - t_i) + b conj(z_j) (t_j - t_i) + c conj(z_i) z_j) of the edges; each (E,) complex."""

    a: ComplexArray
    b: ComplexArray
    c: ComplexArray


def quadratic_form(
    problem: Problem, tau: FloatArray, kappa: FloatArray, couplings: Couplings | None = None
) -> QuadraticForm:
    """The form with weights tau (E,) of translations and kappa (E,) of headings."""
    size, edges = problem.size, len(problem.i)
    row = np.arange(edges)
    p = problem.i_T_j[:, 0] + 1j * problem.i_T_j[:, 1]
    root_t, root_k = np.sqrt(tau), np.sqrt(kappa)
    nodes = size + 1  # the world is one: headings first, then positions
    b = coo_array(
        (
            np.concatenate(
                [root_t, -root_t, -root_t * p, root_k, -root_k * np.exp(1j * problem.i_T_j[:, 2])]
            ),
            (
                np.concatenate([row, row, row, edges + row, edges + row]),
                np.concatenate([nodes + problem.j, nodes + problem.i, problem.i, problem.j, problem.i]),
            ),
        ),
        shape=(2 * edges, 2 * nodes),
    ).tocsr()
    free = np.flatnonzero(~problem.held)
    expansion = _expansion(problem, free)
    reduced = b @ expansion
    q = csc_array(reduced.conj().T @ reduced)
    if couplings is not None:
        half = expansion.conj().T @ _coupled(problem, couplings) @ expansion
        q = csc_array(q + half + half.conj().T)
    return QuadraticForm(q, free)


def _coupled(problem: Problem, terms: Couplings) -> csc_array:
    """(2N + 2, 2N + 2) half of the Hermitian matrix of the terms, which are sums of a number and its conjugate."""
    i, j, nodes = problem.i, problem.j, problem.size + 1
    values = 0.5 * np.concatenate([terms.a, -terms.a, terms.b, -terms.b, terms.c])
    rows = np.concatenate([i, i, j, j, i])
    columns = np.concatenate([nodes + j, nodes + i, nodes + j, nodes + i, j])
    return csc_array(coo_array((values, (rows, columns)), shape=(2 * nodes, 2 * nodes)))


def _expansion(problem: Problem, free: IntArray) -> csc_array:
    """(2N + 2, 2F + 1): headings and positions of all nodes from the unknowns."""
    size, count = problem.size, len(free)
    held = np.flatnonzero(problem.held)
    poses = problem.world_T_pose[held]
    column = np.arange(count)
    rows = np.concatenate([free, [size], held, size + 1 + free, size + 1 + held])
    world = np.full(len(held), count)
    columns = np.concatenate([column, [count], world, count + 1 + column, world])
    values = np.concatenate(
        [np.ones(count + 1), np.exp(1j * poses[:, 2]), np.ones(count), poses[:, 0] + 1j * poses[:, 1]]
    )
    return csc_array(coo_array((values, (rows, columns)), shape=(2 * size + 2, 2 * count + 1)))


def order_of_free_poses(problem: Problem) -> IntArray:
    """(F,) numbers of the free poses, counted from 0, in an order of elimination."""
    number = np.full(problem.size + 1, -1)
    number[:-1][~problem.held] = np.arange(int((~problem.held).sum()))
    i, j = number[problem.i], number[problem.j]
    inner = (i >= 0) & (j >= 0)
    return elimination_order(i[inner], j[inner], int((~problem.held).sum()))


def chordal_start(problem: Problem) -> FloatArray | None:
    """Poses (N, 3) of the form's minimum when headings need not have length one, then brought to it.

    Needs no guess. None where the edges do not say where every pose is.
    """
    trace = 0.5 * (problem.information[:, 0, 0] + problem.information[:, 1, 1])
    form = quadratic_form(problem, trace, problem.information[:, 2, 2])
    count = len(form.free)
    if count == 0:
        return problem.world_T_pose.copy()
    order = order_of_free_poses(problem)
    kappa_only = quadratic_form(problem, np.zeros_like(trace), problem.information[:, 2, 2])
    z = _solve(kappa_only.q[:count, :count], -kappa_only.q[:count, [count]].toarray()[:, 0], order)
    if z is None or np.abs(z).min() == 0:
        return None
    headings = np.concatenate([z / np.abs(z), [1.0]])
    t = _solve(form.q[count + 1 :, count + 1 :].real, -(form.q[count + 1 :, : count + 1] @ headings), order)
    if t is None:
        return None
    return form.poses(np.concatenate([headings, t]), problem.world_T_pose)


def _solve(matrix: csc_array, right: ComplexArray, order: IntArray) -> ComplexArray | None:
    """Solution of a positive definite system, or None when it is singular."""
    factors = SymmetricFactors(csc_array(matrix), order)
    if not factors.exists:
        return None
    out = np.asarray(factors.solve(right), dtype=np.complex128)
    return out if np.isfinite(out).all() else None
