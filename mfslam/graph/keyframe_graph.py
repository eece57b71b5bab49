"""The pose graph: own record of every edge, so that edges can be taken out again and come back, and the graph can be
written at full precision."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from mfslam.config import GraphConfig
from mfslam.graph.edges import EdgeArrays
from mfslam.graph.least_squares import PoseSolver
from mfslam.graph.robust_solve import graduated_solve
from mfslam.kernels import graph_terms
from mfslam.kernels import poses as pose_kernels
from mfslam.types import BoolArray, Edge, FloatArray, IntArray, MfslamError
from mfslam.uncertainty import chi2_quantile

NEAR_M, NEAR_RAD = 0.1, 0.02  # a loop that contradicts the poses by less can wait for a solve
GAIN_ON_THE_WAY = 1e-4  # of the error, below which a solve while mapping has arrived
ADJUSTED_WEIGHT = 10.0  # of what an adjustment says against a single match: it had many scans for each step
# of the keyframes, which alone are solved for while the others stand where the last solve left them
LATEST_SHARE = 0.1
DISPUTE_LEAST, DISPUTE_SHARE = 3, 0.1  # new loops, of all, before the next dispute is settled


class PoseGraph:
    """Keyframe poses and the edges between them; the first keyframe is where the world hangs.

    Until a loop closes nothing moves: new keyframes stand where their step leads. Loops that would hardly move anything
    wait, where only rough poses are asked for.
    """

    def __init__(self, config: GraphConfig) -> None:
        self.config = config
        self.edges: list[Edge] = []
        self._arrays = EdgeArrays()
        self._count = 0
        self._world_T_body = np.empty((64, 3))
        self._removed: set[int] = set()
        self._refused: set[int] = set()  # loops that a dispute took out
        self._judged = 0  # loops at the last dispute
        self._loops: list[int] = []  # numbers of all loops that ever were
        self._waiting = 0  # loops that no solve has seen
        self._is_contradicted = False  # by a loop that waits
        self._has_moved = False  # since the loops were last asked whether they are satisfied
        self._solved = 0, 0  # keyframes and edges when all were solved for last

    def __len__(self) -> int:
        return self._count

    @property
    def _poses(self) -> FloatArray:
        return self._world_T_body[: self._count]

    def add_first(self, world_T_body: FloatArray) -> None:
        """The keyframe that the world hangs on."""
        self._add_pose(world_T_body)

    def add_keyframe(self, prev_T_body: FloatArray, edges: list[Edge]) -> None:
        """Next keyframe, placed from the previous one, with the edges that tie it to earlier ones."""
        self._add_pose(pose_kernels.compose(self._poses[-1], prev_T_body))
        for edge in edges:
            self.add_edge(edge)

    def add_edge(self, edge: Edge) -> int:
        """Number of the new edge. Raises MfslamError for an edge that would corrupt the solver."""
        if not (0 <= edge.i < len(self) and 0 <= edge.j < len(self)):
            raise MfslamError(f"edge {edge.i}-{edge.j}: no such keyframe (there are {len(self)})")
        if not (np.all(np.isfinite(edge.i_T_j)) and np.all(np.isfinite(edge.information))):
            raise MfslamError(f"edge {edge.i}-{edge.j}: measurement or information is not finite")
        number = len(self.edges)
        self.edges.append(edge)
        self._arrays.append(edge)
        if edge.kind == "loop":
            self._loops.append(number)
            self._waiting += 1
            i_T_j = pose_kernels.between(self._poses[edge.i], self._poses[edge.j])
            x, y, theta = pose_kernels.between(edge.i_T_j, i_T_j)
            self._is_contradicted |= math.hypot(x, y) > NEAR_M or abs(theta) > NEAR_RAD
        return number

    def remove_edges(self, numbers: list[int]) -> None:
        """Take edges out again, from the record and from the solution."""
        self._removed.update(numbers)
        self._solve()

    def live_edges(self) -> list[Edge]:
        return [e for n, e in enumerate(self.edges) if n not in self._removed | self._refused]

    def poses(self) -> FloatArray:
        """(K, 3) world_T_body of every keyframe, as the latest solve has them."""
        if self._waiting:
            self._solve()
        return self._poses.copy()

    def rough_poses(self) -> FloatArray:
        """(K, 3) world_T_body of every keyframe, as exact as a search needs them: solved anew only when a loop
        contradicts them by more than NEAR_M or NEAR_RAD. To be read, until the next solve."""
        self._settle_contradiction()
        return self.standing_poses()

    def standing_poses(self) -> FloatArray:
        """(K, 3) world_T_body of every keyframe, whatever waits to be solved. To be read, until the next solve."""
        return self._poses  # not flagged so: kernels would be compiled anew for such arrays, in mid-run

    def seen_poses(self) -> FloatArray:
        """(K, 3) what `rough_poses` would say, for those who only look: the graph stays as it is, and so does all that
        is found later."""
        if not self._is_contradicted:
            return self._poses.copy()
        return self.solved_with(np.zeros(0, np.int64), np.zeros((0, 3)), self._poses)

    def numbers_in_use(self) -> IntArray:
        """Of the edges, in order."""
        return np.flatnonzero(self._in_use())

    def loops_among(self, numbers: IntArray) -> IntArray:
        """Those of these edges that are loops."""
        return numbers[self._arrays.is_loop[numbers]]

    def still_known(self, known: IntArray, known_poses: FloatArray) -> IntArray:
        """Of edges numbered ``known``, from which ``known_poses`` (K', 3) were found, those that they still tell of: not
        those taken out since, nor, where the poses believed one of these, what it had closed."""
        e, in_use = self._arrays, self._in_use()[known] > 0.0
        known, out = known[in_use], known[~in_use]
        chi2 = graph_terms.edge_chi2(e.ends[out], e.measured[out], e.information[out], known_poses)
        for i, j in e.ends[out[chi2 < self.config.loop_kernel_sigmas**2]]:
            ends = e.ends[known]
            known = known[((ends < i) | (ends > j)).any(axis=1)]
        return known

    def solved_with(self, known: IntArray, known_poses: FloatArray, start: FloatArray) -> FloatArray:
        """(K, 3) poses from ``start`` (K, 3), if the edges numbered ``known`` had measured what ``known_poses`` (K', 3) of
        the first keyframes say. The graph stays as it is."""
        arrays, weights = self._arrays.restated(known, known_poses), self._in_use()
        weights[known] = ADJUSTED_WEIGHT
        return PoseSolver(arrays, len(self)).solve(
            start, weights, arrays.is_loop, self.config.loop_kernel_sigmas,
            relative_gain=GAIN_ON_THE_WAY,
        )  # fmt: skip

    def optimize(self, edges: list[Edge]) -> list[Edge]:
        """Batch solve from the poses as they stand with these edges; robust on loops by graduated
        non-convexity.

        Returns the edges with the weight that the solve left them; the poses of the graph become the
        solution.
        """
        if self._waiting:
            self._solve()
        weights = self._decide(EdgeArrays(edges), _believed(edges))
        return [dataclasses.replace(e, weight=float(w)) for e, w in zip(edges, weights, strict=True)]

    def place(self, world_T_body: FloatArray, edges: list[Edge]) -> list[Edge]:
        """Take over poses (K, 3) that were found elsewhere. Returns the edges with what their kernels leave of them
        there, nothing of loops that are not satisfied; those that the solve refused stay refused."""
        self._move(world_T_body)
        arrays = EdgeArrays(edges)
        weights = np.where(self._violated(arrays), 0.0, self._kernel_weights(arrays))
        return [
            e if e.weight < 0.5 else dataclasses.replace(e, weight=float(w))
            for e, w in zip(edges, weights, strict=True)
        ]

    def optimize_with(self, edges: list[Edge]) -> list[Edge]:
        """Batch solve from the poses as they stand with these edges instead, robust on scans and loops.

        Loops that an earlier solve refused (weight below one half) stay out. Returns the edges with the
        weights of their kernels; the poses of the graph become the solution.
        """
        arrays, used = EdgeArrays(edges), _believed(edges)
        solver = PoseSolver(arrays, len(self))
        self._move(
            solver.solve(
                self._poses, used.astype(np.float64), arrays.is_match, self.config.loop_kernel_sigmas
            )
        )
        weights = self._kernel_weights(arrays)
        return [
            dataclasses.replace(e, weight=float(w)) if u else e
            for e, w, u in zip(edges, weights, used, strict=True)
        ]

    def optimize_satisfied(self, edges: list[Edge]) -> list[Edge]:
        """The same until every loop in use (weight of at least one half) is satisfied: those that are not are
        taken out."""
        while True:
            unsatisfied = _believed(edges) & self._violated(EdgeArrays(edges))
            if not unsatisfied.any():
                return edges
            edges = [
                dataclasses.replace(e, weight=0.0) if out else e
                for e, out in zip(edges, unsatisfied, strict=True)
            ]
            edges = self.optimize_with(edges)

    def settle_disputes(self) -> tuple[list[Edge], list[Edge]]:
        """Loops that were believed and are taken out now, and loops that come back.

        When a loop is violated, the robust batch solve decides between all that were ever found. Not for each
        new one: a fair share of them has to be new since the last time.
        """
        count = len(self._loops)
        if count - self._judged < max(DISPUTE_LEAST, DISPUTE_SHARE * count):
            return [], []
        self._settle_contradiction()
        if not self._has_moved:
            return [], []
        self._has_moved = False
        believed = self._in_use() > 0.0
        if not (believed & self._violated(self._arrays)).any():
            return [], []
        self._judged = count
        before = self._poses.copy()
        weights = self._decide(self._arrays, believed)
        refused = set(np.flatnonzero(weights < 0.5).tolist()) - self._removed
        out, back = refused - self._refused, self._refused - refused
        if out or back:
            self._refused = refused
            self._solve()
        else:
            self._poses[:] = before
        return [self.edges[n] for n in sorted(out)], [self.edges[n] for n in sorted(back)]

    def release(self) -> None:
        """Drop the edges; the poses stay."""
        self.edges, self._arrays, self._loops = [], EdgeArrays(), []
        self._removed, self._refused, self._waiting, self._solved = set(), set(), 0, (0, 0)

    def edges_to_judge(self) -> list[Edge]:
        """The live edges, and, at weight 0, the loops that a dispute took out: they may come back."""
        return [
            dataclasses.replace(e, weight=0.0) if n in self._refused else e
            for n, e in enumerate(self.edges)
            if n not in self._removed
        ]

    # --- inside ---------------------------------------------------------------------------------------

    def _add_pose(self, world_T_body: FloatArray) -> None:
        if self._count == len(self._world_T_body):
            self._world_T_body = np.concatenate([self._world_T_body, np.empty_like(self._world_T_body)])
        self._world_T_body[self._count] = world_T_body
        self._count += 1

    def _move(self, world_T_body: FloatArray) -> None:
        self._poses[:] = world_T_body

    def _in_use(self) -> FloatArray:
        """(E,) 1 of edges in use, 0 of those that were taken out."""
        out = np.ones(len(self.edges))
        out[[*self._removed, *self._refused]] = 0.0
        return out

    def _settle_contradiction(self) -> None:
        """Where a loop contradicts the poses, they give way: the latest ones, if that settles it, else all."""
        if self._is_contradicted and not self._solve_latest():
            self._solve()

    def _solve_latest(self) -> bool:
        """Solve for the keyframes since all were solved for last, those before being held. False, and nothing moves, where
        these are too many, or a loop still contradicts the poses."""
        held, known = self._solved
        if not 0 < len(self) - held <= LATEST_SHARE * held:
            return False
        edges, in_use = self._arrays.since(known), self._in_use()[known:]
        solved = PoseSolver(edges, len(self), held).solve(
            self._poses, in_use, edges.is_loop, self.config.loop_kernel_sigmas, relative_gain=GAIN_ON_THE_WAY
        )
        loops = np.flatnonzero(edges.is_loop & (in_use > 0.0))
        if edges.are_off(loops, solved, NEAR_M, NEAR_RAD).any():
            return False
        self._poses[:] = solved
        self._is_contradicted, self._has_moved = False, True
        return True

    def _solve(self) -> None:
        """All that waits is taken in."""
        solver = PoseSolver(self._arrays, len(self))
        solved = solver.solve(
            self._poses, self._in_use(), self._arrays.is_loop, self.config.loop_kernel_sigmas,
            relative_gain=GAIN_ON_THE_WAY,
        )  # fmt: skip
        self._poses[:] = solved
        self._waiting, self._is_contradicted, self._has_moved = 0, False, True
        self._solved = len(self), len(self.edges)

    def _violated(self, edges: EdgeArrays) -> BoolArray:
        """(E,) which edges are loops off by more than one in use may be, at the poses as they stand."""
        out, loops = np.zeros(len(edges), np.bool_), np.flatnonzero(edges.is_loop)
        limit_m, limit_rad = self.config.loop_satisfied_m, math.radians(self.config.loop_satisfied_deg)
        out[loops] = edges.are_off(loops, self._poses, limit_m, limit_rad)
        return out

    def _decide(self, edges: EdgeArrays, believed: BoolArray) -> FloatArray:
        """Robust batch solve from the poses as they stand, which become the solution; weight (E,) of each edge,
        0 or 1.

        Loops that are not ``believed`` (E,) so far have no say: a solve that begins with all false
        loops at once may fold the graph. They come back where the solution satisfies them. A solution that
        costs more than the poses as they stood, no loop counting for more than its limit, is no solution.
        """
        solver, limit = PoseSolver(edges, len(self)), chi2_quantile(self.config.loop_inlier_probability)
        limits = np.where(edges.is_loop, limit, np.inf)

        def cost(poses: FloatArray) -> float:
            return float(np.minimum(solver.chi2(poses), limits)[believed].sum())

        solved = graduated_solve(solver, self._poses, believed.astype(np.float64), edges.is_loop, limit)
        if cost(solved) <= cost(self._poses):
            self._move(solved)
        return np.where(solver.chi2(self._poses) <= limits, 1.0, 0.0)

    def _kernel_weights(self, edges: EdgeArrays) -> FloatArray:
        """What the Cauchy kernel leaves of scan and loop edges at the poses as they stand; 1 for others."""
        chi2 = graph_terms.edge_chi2(edges.ends, edges.measured, edges.information, self._poses)
        return np.where(edges.is_match, 1.0 / (1.0 + chi2 / self.config.loop_kernel_sigmas**2), 1.0)


def _believed(edges: list[Edge]) -> BoolArray:
    return np.array([e.weight >= 0.5 for e in edges], dtype=np.bool_)
