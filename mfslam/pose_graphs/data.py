"""A pose graph as its file tells it, and the same in row numbers, as solvers want it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mfslam import se2
from mfslam.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class GraphFile:
    """A pose graph as a file tells it.

    ``ids`` (N,) and ``world_T_pose`` (N, 3) in file order; ``fixed``: ids held where they are. Edges E:
    ``i``, ``j`` (E,) ids, equal for a prior; ``i_T_j`` (E, 3), for a prior the pose itself;
    ``information`` (E, 3, 3), order x, y, theta. ``notes``: what a user should know of how it was read.
    """

    ids: IntArray
    world_T_pose: FloatArray
    fixed: frozenset[int]
    i: IntArray
    j: IntArray
    i_T_j: FloatArray
    information: FloatArray
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Problem:
    """A pose graph in row numbers. Row N, after the N poses, is the world: it stays at the origin.

    ``world_T_pose`` (N, 3); ``i``, ``j`` (E,) rows, i = N for a prior; ``i_T_j`` (E, 3);
    ``information`` (E, 3, 3); ``held`` (N,): poses that do not move.
    """

    world_T_pose: FloatArray
    i: IntArray
    j: IntArray
    i_T_j: FloatArray
    information: FloatArray
    held: BoolArray

    @property
    def size(self) -> int:
        return len(self.world_T_pose)

    def residuals(self, world_T_pose: FloatArray) -> FloatArray:
        """(E, 3): log(inverse(i_T_j) * estimate) of every edge at poses (N, 3), as gtsam's factors have it."""
        poses = np.vstack([world_T_pose, np.zeros(3)])
        return se2.log(se2.between(self.i_T_j, se2.between(poses[self.i], poses[self.j])))

    def chi2(self, world_T_pose: FloatArray) -> FloatArray:
        """(E,): squared Mahalanobis length of every edge's residual; their sum is twice gtsam's error."""
        e = self.residuals(world_T_pose)
        return np.asarray(np.einsum("ea,eab,eb->e", e, self.information, e))

    def chain(self) -> BoolArray:
        """(E,): edges from a pose to the next one in the file, which odometry makes; priors count too."""
        return np.asarray((self.j - self.i == 1) | (self.i - self.j == 1) | (self.i == self.size))

    def open_poses(self) -> IntArray:
        """Rows of free poses of which no edge says anything in some direction."""
        back = se2.adjoint(se2.inverse(self.i_T_j))
        at_pose = np.zeros((self.size + 1, 3, 3))
        np.add.at(at_pose, self.j, self.information)
        np.add.at(at_pose, self.i, back.swapaxes(-1, -2) @ self.information @ back)
        eigenvalues = np.linalg.eigvalsh(at_pose[:-1])
        return np.flatnonzero(~self.held & (eigenvalues[:, 0] <= 1e-12 * eigenvalues[:, 2]))

    def part(self, edges: BoolArray) -> Problem:
        """The same poses with some of the edges (E,)."""
        return Problem(
            self.world_T_pose,
            self.i[edges],
            self.j[edges],
            self.i_T_j[edges],
            self.information[edges],
            self.held,
        )


def components(graph: GraphFile) -> IntArray:
    """(N,) number of the part that each vertex belongs to; parts are numbered by their first vertex.

    Fixed vertices and those with a prior hang on the world, so they are of one part.
    """
    rows = rows_of(graph)
    size = len(graph.ids)
    i, j = rows(graph.i), rows(graph.j)
    anchored = np.concatenate([rows(np.array(sorted(graph.fixed), dtype=np.int64)), i[i == j]])
    heads = np.concatenate([i, np.full(len(anchored), size)])
    tails = np.concatenate([j, anchored])
    from scipy.sparse import coo_array  # here: a run that only writes its graph need not wait for it
    from scipy.sparse.csgraph import connected_components

    links = coo_array((np.ones(len(heads)), (heads, tails)), shape=(size + 1, size + 1))
    _, labels = connected_components(links, directed=False)
    labels = labels[:size]
    _, first, number = np.unique(labels, return_index=True, return_inverse=True)
    rank = np.argsort(np.argsort(first))
    return np.asarray(rank[number], dtype=np.int64)


def problem_of(graph: GraphFile) -> tuple[Problem, IntArray]:
    """The graph in row numbers, and the rows (G,) held for want of anything else that says where a part is.

    In every part that neither a FIX nor a prior ties to the world the first pose of the file is held.
    """
    rows = rows_of(graph)
    i, j = rows(graph.i), rows(graph.j)
    prior = i == j
    held = np.zeros(len(graph.ids), dtype=np.bool_)
    held[rows(np.array(sorted(graph.fixed), dtype=np.int64))] = True
    part = components(graph)
    anchored = np.unique(part[np.concatenate([np.flatnonzero(held), i[prior]])])
    _, first = np.unique(part, return_index=True)
    gauge = np.setdiff1d(first, first[anchored])
    held[gauge] = True
    world = len(graph.ids)
    problem = Problem(graph.world_T_pose, np.where(prior, world, i), j, graph.i_T_j, graph.information, held)
    return problem, np.asarray(gauge, dtype=np.int64)


class rows_of:
    """Row numbers of ids, all of which are known."""

    def __init__(self, graph: GraphFile) -> None:
        self._order = np.argsort(graph.ids)
        self._sorted = graph.ids[self._order]

    def __call__(self, ids: IntArray) -> IntArray:
        return np.asarray(self._order[np.searchsorted(self._sorted, ids)])
