"""Single Gauss-Newton steps of a pose graph under changing weights.

An annealed solve takes hundreds of steps, each with other weights and so with other edges; false loops join everything
with everything at first. `least_squares` is made for one pattern that stays thin: with 2,000 false loops among 3,500 poses
its blocks take 2.6 s a step where SuperLU's dense columns take 1.6 s, though a quarter of SuperLU's time once they are out.
Normal equations are summed from arrays, with right perturbations T exp(d) and e = log(inverse(i_T_j) inverse(T_i) T_j):
de/dd_j = 1 and de/dd_i = -Ad(inverse(T_j) T_i) to first order in e, as in gtsam's BetweenFactor.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array, csc_array
from scipy.sparse.linalg import splu

from mfslam import se2
from mfslam.pose_graphs.data import Problem
from mfslam.types import FloatArray, IntArray, MfslamError


def step(problem: Problem, world_T_pose: FloatArray, weights: FloatArray) -> FloatArray:
    """Poses (N, 3) after one step with weights (E,) of the edges.

    Raises MfslamError when the edges leave a pose open.
    """
    free = np.flatnonzero(~problem.held)
    if not len(free):
        return world_T_pose.copy()
    column = np.full(problem.size + 1, -1)
    column[free] = np.arange(len(free))
    hessian, slope = _normal_equations(problem, world_T_pose, weights, column, len(free))
    try:
        factors = splu(
            hessian, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
        )
        moved = factors.solve(-slope).reshape(-1, 3)
    except RuntimeError:  # exactly singular
        moved = np.full((1, 3), np.nan)
    if not np.isfinite(moved).all():
        raise MfslamError("the edges leave a pose open, so there is no one best graph")
    out = world_T_pose.copy()
    out[free] = se2.compose(world_T_pose[free], se2.exp(moved))
    return out


def _normal_equations(
    problem: Problem, world_T_pose: FloatArray, weights: FloatArray, column: IntArray, unknowns: int
) -> tuple[csc_array, FloatArray]:
    used = np.flatnonzero(weights > 0)
    poses = np.vstack([world_T_pose, np.zeros(3)])  # the world is the last
    i, j = problem.i[used], problem.j[used]
    estimate = se2.between(poses[i], poses[j])
    error = se2.log(se2.between(problem.i_T_j[used], estimate))
    information = problem.information[used] * weights[used, None, None]
    by_i = -se2.adjoint(se2.inverse(estimate))
    at_j = np.einsum("eab,eb->ea", information, error)
    at_i = np.einsum("eba,eb->ea", by_i, at_j)
    mixed = information @ by_i  # (j, i)
    blocks = np.concatenate([by_i.swapaxes(1, 2) @ mixed, information, mixed, mixed.swapaxes(1, 2)])
    rows, columns = column[np.concatenate([i, j, j, i])], column[np.concatenate([i, j, i, j])]
    known = (rows >= 0) & (columns >= 0)
    axis = np.arange(3)
    row = np.broadcast_to(3 * rows[known, None, None] + axis[:, None], (int(known.sum()), 3, 3))
    col = np.broadcast_to(3 * columns[known, None, None] + axis, row.shape)
    size = 3 * unknowns
    hessian = coo_array((blocks[known].ravel(), (row.ravel(), col.ravel())), shape=(size, size))
    slope = np.zeros((unknowns + 1, 3))  # those that do not move: the last row
    np.add.at(slope, column[i], at_i)
    np.add.at(slope, column[j], at_j)
    return csc_array(hessian), slope[:-1].ravel()
