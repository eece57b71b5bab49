"""The pose graph: the only owner of gtsam.ISAM2. Own record of every edge, so that nothing is lost when
gtsam fails, edges can be taken out again, and the graph can be written at full precision."""

from __future__ import annotations

import dataclasses
import math

import gtsam
import numpy as np

import factors
from mfslam import se2
from mfslam.config import GraphConfig
from mfslam.graph.robust_solve import graduated_solve
from mfslam.kernels import poses as pose_kernels
from mfslam.types import BoolArray, Edge, FloatArray, MfslamError
from mfslam.uncertainty import chi2_quantile

SETTLED = 0.1  # m or rad: a loop that moves the newest pose less needs no further iteration
NEAR_M, NEAR_RAD = 0.1, 0.02  # a loop that contradicts the poses by less can wait for a solve
DISPUTE_LEAST, DISPUTE_SHARE = 3, 0.1  # new loops, of all, before the next dispute is settled
PRIOR_SIGMAS = np.array([1e-4, 1e-4, 1e-5])  # the first pose defines the world


class PoseGraph:
    """Keyframe poses and the edges between them.

    New keyframes and edges wait until a loop closes or a marginal is asked for: until then nothing moves,
    and an update of many poses at once costs little more than one of a single pose. Loops that would hardly
    move anything wait too, where only rough poses are asked for.
    """

    def __init__(self, config: GraphConfig) -> None:
        self.config = config
        self.edges: list[Edge] = []
        self._count = 0
        self._world_T_body = np.empty((64, 3))
        self._isam = self._new_isam()
        self._pending_factors = gtsam.NonlinearFactorGraph()
        self._pending_edges: list[int] = []
        self._pending_values = gtsam.Values()
        self._factor_slots: dict[int, int] = {}  # edge number -> slot in iSAM2
        self._removed: set[int] = set()
        self._refused: set[int] = set()  # loops that a dispute took out
        self._judged = 0  # loops at the last dispute
        self._loops: list[int] = []  # numbers of all loops that ever were
        self._is_contradicted = False  # by a loop that waits
        self._has_moved = False  # since the loops were last asked whether they are satisfied

    def __len__(self) -> int:
        return self._count

    @property
    def _poses(self) -> FloatArray:
        return self._world_T_body[: self._count]

    def add_first(self, world_T_body: FloatArray) -> None:
        """The keyframe that the world hangs on."""
        self._add_pose(world_T_body)
        self._pending_factors.add(factors.prior_factor(0, world_T_body, PRIOR_SIGMAS))
        self._pending_edges.append(-1)

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
        self._pending_factors.add(self._factor(edge, robust=edge.kind == "loop"))
        self._pending_edges.append(number)
        if edge.kind == "loop":
            self._loops.append(number)
            x, y, theta = self._error(edge)
            self._is_contradicted |= math.hypot(x, y) > NEAR_M or abs(theta) > NEAR_RAD
        return number

    def remove_edges(self, numbers: list[int]) -> None:
        """Take edges out again, from the record and from the incremental solution."""
        self._flush()
        params = gtsam.ISAM2UpdateParams()
        params.removeFactorIndices = [self._factor_slots.pop(n) for n in numbers]
        self._isam.update(gtsam.NonlinearFactorGraph(), gtsam.Values(), params)
        self._removed.update(numbers)
        self._settle()

    def live_edges(self) -> list[Edge]:
        return [e for n, e in enumerate(self.edges) if n not in self._removed | self._refused]

    def poses(self) -> FloatArray:
        """(K, 3) world_T_body of every keyframe, as the latest solve has them."""
        if any(n >= 0 and self.edges[n].kind == "loop" for n in self._pending_edges):
            self._flush()
        return self._poses.copy()

    def rough_poses(self) -> FloatArray:
        """(K, 3) world_T_body of every keyframe, as exact as a search needs them: solved anew only when a loop
        contradicts them by more than NEAR_M or NEAR_RAD."""
        if self._is_contradicted:
            self._flush()
        return self._poses.copy()

    def relative_covariance(self, i: int, j: int) -> FloatArray:
        """(3, 3) covariance of i_T_j, in its tangent, from the joint marginal of both poses."""
        self._flush()
        keys = gtsam.KeyVector([i, j])
        joint = self._isam.jointMarginalCovariance(keys)
        i_T_j = se2.between(self._poses[i], self._poses[j])
        jacobian = -se2.adjoint(se2.inverse(i_T_j))
        ii, ij, jj = joint.at(i, i), joint.at(i, j), joint.at(j, j)
        cross = jacobian @ ij
        return np.asarray(jacobian @ ii @ jacobian.T + cross + cross.T + jj)

    def optimize(self, edges: list[Edge]) -> list[Edge]:
        """Batch solve from the poses as they stand with these edges; robust on loops by graduated
        non-convexity.

        Returns the edges with the weight that the solve left them; the poses of the graph become the
        solution.
        """
        self._flush()
        weights = self._decide(edges)
        return [dataclasses.replace(e, weight=float(w)) for e, w in zip(edges, weights, strict=True)]

    def place(self, world_T_body: FloatArray, edges: list[Edge]) -> list[Edge]:
        """Take over poses (K, 3) that were found elsewhere. Returns the edges with what their kernels leave of them
        there, nothing of loops that are not satisfied; those that the solve refused stay refused."""
        self._poses[:] = world_T_body
        weights = np.where(self._violated(edges), 0.0, self._kernel_weights(edges))
        return [
            e if e.weight < 0.5 else dataclasses.replace(e, weight=float(w))
            for e, w in zip(edges, weights, strict=True)
        ]

    def optimize_with(self, edges: list[Edge]) -> list[Edge]:
        """Batch solve from the poses as they stand with these edges instead, robust on scans and loops.

        Loops that an earlier solve refused (weight below one half) stay out. Returns the edges with the
        weights of their kernels; the poses of the graph become the solution.
        """
        used = [e for e in edges if e.weight >= 0.5]
        values = gtsam.LevenbergMarquardtOptimizer(self._graph(used, robust=True), self._values()).optimize()
        self._poses[:] = gtsam.utilities.extractPose2(values)
        weights = iter(self._kernel_weights(used).tolist())
        return [dataclasses.replace(e, weight=next(weights)) if e.weight >= 0.5 else e for e in edges]

    def optimize_satisfied(self, edges: list[Edge]) -> list[Edge]:
        """The same until every loop in use (weight of at least one half) is satisfied: those that are not are
        taken out."""
        while True:
            used = np.array([e.weight >= 0.5 for e in edges], dtype=np.bool_)
            unsatisfied = used & self._violated(edges)
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
        if self._is_contradicted:
            self._flush()
        if not self._has_moved:
            return [], []
        self._has_moved = False
        out_of_use = self._removed | self._refused
        if not self._violated([self.edges[n] for n in self._loops if n not in out_of_use]).any():
            return [], []
        self._judged = count
        numbers = [n for n in range(len(self.edges)) if n not in self._removed]
        before = self._poses.copy()
        weights = self._decide(self.edges_to_judge())
        refused = {n for n, w in zip(numbers, weights, strict=True) if w < 0.5}
        out, back = refused - self._refused, self._refused - refused
        if out or back:
            self._refused = refused
            self._rebuild()
        else:
            self._poses[:] = before
        return [self.edges[n] for n in sorted(out)], [self.edges[n] for n in sorted(back)]

    def release_increments(self) -> None:
        """Drop the incremental solution, after `optimize`: nothing more is going to be added."""
        self._isam = self._new_isam()

    def release(self) -> None:
        """Drop the incremental solution and the edges; the poses stay."""
        self.release_increments()
        self.edges, self._factor_slots = [], {}
        self._pending_edges, self._pending_factors = [], gtsam.NonlinearFactorGraph()
        self._pending_values = gtsam.Values()

    def edges_to_judge(self) -> list[Edge]:
        """The live edges, and, at weight 0, the loops that a dispute took out: they may come back."""
        return [
            dataclasses.replace(e, weight=0.0) if n in self._refused else e
            for n, e in enumerate(self.edges)
            if n not in self._removed
        ]

    # --- inside ---------------------------------------------------------------------------------------

    def _new_isam(self) -> gtsam.ISAM2:
        params = gtsam.ISAM2Params()
        params.setRelinearizeThreshold(0.02)
        params.relinearizeSkip = 1
        params.findUnusedFactorSlots = True
        return gtsam.ISAM2(params)

    def _add_pose(self, world_T_body: FloatArray) -> None:
        if self._count == len(self._world_T_body):
            self._world_T_body = np.concatenate([self._world_T_body, np.empty_like(self._world_T_body)])
        self._pending_values.insert(self._count, gtsam.Pose2(*world_T_body))
        self._world_T_body[self._count] = world_T_body
        self._count += 1

    def _factor(self, edge: Edge, robust: bool) -> gtsam.NonlinearFactor:
        if edge.kind == "heading":
            sigma_rad = float(edge.information[2, 2]) ** -0.5
            if edge.i == edge.j:
                return factors.compass_factor(edge.i, float(edge.i_T_j[2]), sigma_rad)
            return factors.gyro_factor(edge.i, edge.j, float(edge.i_T_j[2]), sigma_rad)
        make = factors.wheel_odometry_factor if edge.kind == "odometry" else factors.scan_match_factor
        factor = make(edge.i, edge.j, edge.i_T_j, edge.information)
        if robust:
            noise = factors.robust_noise(factor.noiseModel(), "cauchy", self.config.loop_kernel_sigmas)
            return gtsam.BetweenFactorPose2(edge.i, edge.j, gtsam.Pose2(*edge.i_T_j), noise)
        return factor

    def _error(self, edge: Edge) -> FloatArray:
        """(3,) from what the edge measured to where the poses stand."""
        i_T_j = pose_kernels.between(self._poses[edge.i], self._poses[edge.j])
        error: FloatArray = pose_kernels.between(edge.i_T_j, i_T_j)
        return error

    def _violated(self, edges: list[Edge]) -> BoolArray:
        """(E,) which edges are loops off by more than one in use may be, at the poses as they stand."""
        error = self._errors(edges)
        limit_m, limit_rad = self.config.loop_satisfied_m, math.radians(self.config.loop_satisfied_deg)
        loops = np.array([e.kind == "loop" for e in edges], dtype=np.bool_)
        return loops & ((np.hypot(error[:, 0], error[:, 1]) > limit_m) | (np.abs(error[:, 2]) > limit_rad))

    def _decide(self, edges: list[Edge]) -> FloatArray:
        """Robust batch solve from the poses as they stand, which become the solution; weight (E,) of each edge,
        0 or 1.

        Loops that were refused already (weight below one half) have no say: a solve that begins with all false
        loops at once may fold the graph. They come back where the solution satisfies them. A solution that
        costs more than the poses as they stood, no loop counting for more than its limit, is no solution.
        """
        used = [e for e in edges if e.weight >= 0.5]
        doubtful = [n + 1 for n, e in enumerate(used) if e.kind == "loop"]  # slot 0 is the prior
        graph, before, cost_before = self._graph(used, robust=False), self._poses.copy(), self._cost(used)
        values = graduated_solve(graph, self._values(), doubtful, self.config.loop_inlier_probability)
        self._poses[:] = gtsam.utilities.extractPose2(values)
        if self._cost(used) > cost_before:
            self._poses[:] = before
        return np.where(self._chi2(edges) <= self._limits(edges), 1.0, 0.0)

    def _cost(self, edges: list[Edge]) -> float:
        """Sum of chi2, to which no loop adds more than its limit."""
        return float(np.minimum(self._chi2(edges), self._limits(edges)).sum())

    def _limits(self, edges: list[Edge]) -> FloatArray:
        """(E,) chi2 above which an edge is an outlier: only loops can be."""
        limit = chi2_quantile(self.config.loop_inlier_probability)
        return np.array([limit if e.kind == "loop" else np.inf for e in edges])

    def _errors(self, edges: list[Edge]) -> FloatArray:
        """(E, 3) from what the edges measured to where the poses stand."""
        ends = np.array([(e.i, e.j) for e in edges], dtype=np.int64).reshape(-1, 2)
        measured = np.array([e.i_T_j for e in edges], dtype=np.float64).reshape(-1, 3)
        return se2.between(measured, se2.between(self._poses[ends[:, 0]], self._poses[ends[:, 1]]))

    def _chi2(self, edges: list[Edge]) -> FloatArray:
        """(E,) of edges between two keyframes, at the poses as they stand."""
        error = self._errors(edges)
        information = np.array([e.information for e in edges]).reshape(-1, 3, 3)
        return np.asarray(np.einsum("ni,nij,nj->n", error, information, error))

    def _kernel_weights(self, edges: list[Edge]) -> FloatArray:
        """What the Cauchy kernel leaves of scan and loop edges at the poses as they stand; 1 for others."""
        robust = np.array([e.kind in ("scan", "loop") for e in edges], dtype=np.bool_)
        return np.where(robust, 1.0 / (1.0 + self._chi2(edges) / self.config.loop_kernel_sigmas**2), 1.0)

    def _graph(self, edges: list[Edge], robust: bool) -> gtsam.NonlinearFactorGraph:
        graph = gtsam.NonlinearFactorGraph()
        graph.add(factors.prior_factor(0, self._poses[0], PRIOR_SIGMAS))
        for edge in edges:
            graph.add(self._factor(edge, robust=robust and edge.kind in ("loop", "scan")))
        return graph

    def _values(self) -> gtsam.Values:
        values = gtsam.Values()
        for key, pose in enumerate(self._poses):
            values.insert(key, gtsam.Pose2(*pose))
        return values

    def _flush(self) -> None:
        """Hand what is waiting to iSAM2; rebuild it from our own record when an update fails."""
        if not self._pending_edges and not self._pending_values.size():
            return
        closes_loop = any(n >= 0 and self.edges[n].kind == "loop" for n in self._pending_edges)
        try:
            result = self._isam.update(self._pending_factors, self._pending_values)
            slots = result.getNewFactorsIndices()
            self._factor_slots.update(zip(self._pending_edges, slots, strict=True))
        except (RuntimeError, IndexError):
            self._rebuild()
        self._forget_pending()
        before = self._poses[-1].copy()
        self._read_back()
        if closes_loop and np.abs(self._poses[-1] - before).max() > SETTLED:
            self._settle()

    def _settle(self) -> None:
        """More iterations after the graph has changed its shape."""
        for _ in range(2):
            self._isam.update()
        self._read_back()

    def _read_back(self) -> None:
        self._has_moved = True
        self._poses[:] = gtsam.utilities.extractPose2(self._isam.calculateEstimate())

    def _rebuild(self) -> None:
        """A failed update leaves ISAM2 corrupt: start anew from the record of edges and poses."""
        self._isam = self._new_isam()
        numbers = [n for n in range(len(self.edges)) if n not in self._removed | self._refused]
        graph = gtsam.NonlinearFactorGraph()
        graph.add(factors.prior_factor(0, self._poses[0], PRIOR_SIGMAS))
        for n in numbers:
            graph.add(self._factor(self.edges[n], robust=self.edges[n].kind == "loop"))
        result = self._isam.update(graph, self._values())
        self._factor_slots = dict(zip([-1, *numbers], result.getNewFactorsIndices(), strict=True))
        self._forget_pending()

    def _forget_pending(self) -> None:
        self._pending_factors, self._pending_edges = gtsam.NonlinearFactorGraph(), []
        self._pending_values = gtsam.Values()
        self._is_contradicted = False
