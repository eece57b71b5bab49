"""Pose graphs as a quadratic form, and the start that follows from it by two linear solves.

With headings as unit complex numbers z and positions as complex numbers t, an edge with translation p and
heading w that weighs its errors alike in all directions costs

    tau |t_j - t_i - z_i p|^2 + kappa |z_j - z_i w|^2 = |B x|^2,   x = (z, t)

(Rosen et al., SE-Sync, IJRR 2019, in the plane; Carlone et al., Initialization techniques for 3D SLAM, ICRA 2015).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array, csc_array, diags_array
from scipy.sparse.linalg import splu

from mfslam.pose_graphs.data import Problem
from mfslam.types import FloatArray, IntArray

ComplexArray = npt.NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class QuadraticForm:
    """x -> |B x|^2 over the unknowns of a graph: F headings of free poses, the world's heading, F positions.

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


def quadratic_form(problem: Problem, tau: FloatArray, kappa: FloatArray) -> QuadraticForm:
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
    reduced = b @ _expansion(problem, free)
    return QuadraticForm(csc_array(reduced.conj().T @ reduced), free)


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


def isotropic_part(information: FloatArray) -> tuple[FloatArray, FloatArray]:
    """tau, kappa (E,): diag(tau, tau, kappa) is below the information matrix (E, 3, 3) in every direction.

    Equal to it where it is of that form already.
    """
    translation = 0.5 * (information[:, 0, 0] + information[:, 1, 1])
    scale = np.sqrt(information[:, 2, 2] / np.where(translation > 0, translation, 1.0))
    usable = (scale > 0) & (translation > 0)
    s = np.stack([np.ones_like(scale), np.ones_like(scale), np.where(usable, scale, 1.0)], axis=-1)
    smallest = np.maximum(np.linalg.eigvalsh(information / (s[:, :, None] * s[:, None, :]))[:, 0], 0.0)
    tau, kappa = smallest, smallest * s[:, 2] ** 2
    off = np.abs(information[:, (0, 0, 1), (1, 2, 2)]).max(axis=1)
    plain = (off == 0) & (information[:, 0, 0] == information[:, 1, 1])
    return np.where(plain, information[:, 0, 0], tau), np.where(plain, information[:, 2, 2], kappa)


def chordal_start(problem: Problem) -> FloatArray | None:
    """Poses (N, 3) of the form's minimum when headings need not have length one, then brought to it.

    Needs no guess. None where the edges do not say where every pose is.
    """
    trace = 0.5 * (problem.information[:, 0, 0] + problem.information[:, 1, 1])
    form = quadratic_form(problem, trace, problem.information[:, 2, 2])
    count = len(form.free)
    if count == 0:
        return problem.world_T_pose.copy()
    kappa_only = quadratic_form(problem, np.zeros_like(trace), problem.information[:, 2, 2])
    z = _solve(kappa_only.q[:count, :count], -kappa_only.q[:count, [count]].toarray()[:, 0])
    if z is None or np.abs(z).min() == 0:
        return None
    headings = np.concatenate([z / np.abs(z), [1.0]])
    t = _solve(form.q[count + 1 :, count + 1 :], -(form.q[count + 1 :, : count + 1] @ headings))
    if t is None:
        return None
    return form.poses(np.concatenate([headings, t]), problem.world_T_pose)


def _solve(matrix: csc_array, right: ComplexArray) -> ComplexArray | None:
    """Solution of a positive definite system, or None when it is singular."""
    factors = factorise(matrix)
    if factors is None:
        return None
    out = factors.solve(np.column_stack([right.real, right.imag]).ravel())
    return out[::2] + 1j * out[1::2] if np.isfinite(out).all() else None


def factorise(matrix: csc_array) -> Any | None:
    """L D L^T of a real symmetric matrix without pivoting (SuperLU in symmetric mode), or None if there is none.

    A Hermitian matrix becomes a real one of twice the size, real and imaginary part in turn: complex
    factorisations are a hundred times as slow there.
    """
    real = _as_real(matrix) if np.iscomplexobj(matrix.data) else matrix
    try:
        factors = splu(real, permc_spec="COLAMD", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    except RuntimeError:  # exactly singular
        return None
    return factors if np.array_equal(factors.perm_r, factors.perm_c) else None


def _as_real(matrix: csc_array) -> csc_array:
    entries = matrix.tocoo()
    row, column = 2 * entries.coords[0], 2 * entries.coords[1]
    re, im = entries.data.real, entries.data.imag
    rows = np.concatenate([row, row, row + 1, row + 1])
    columns = np.concatenate([column, column + 1, column, column + 1])
    size = 2 * matrix.shape[0]
    out = csc_array(coo_array((np.concatenate([re, -im, im, re]), (rows, columns)), shape=(size, size)))
    out.eliminate_zeros()
    return out


def add_diagonal(matrix: csc_array, diagonal: FloatArray) -> csc_array:
    return csc_array(matrix + diags_array(diagonal, format="csc"))
