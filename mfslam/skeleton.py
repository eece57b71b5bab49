"""The skeleton of a pose graph: one keyframe for each spot that was seen, and how surely these know of each other."""

from __future__ import annotations

from array import array
from collections.abc import Sequence

import numpy as np

from mfslam import se2
from mfslam.kernels import poses, reach
from mfslam.sparse_blocks import inverse_diagonal
from mfslam.types import Edge, FloatArray, IntArray

# what an edge that leaves a direction open says of it at least: 1 m, 1 m, 0.3 rad
LEAST_KNOWN = np.diag([1.0, 1.0, 10.0])
SPACING_M, SAME_WAY_RAD = 3.0, 1.0  # within which two keyframes are at one spot
# A loop ties knots where the surest path between them has so many times its variance: the ties are a spanner of the graph
# (Althoefer et al. 1993), of which the knots, not the loops, decide the size.
STRETCH = 2.0
DETOUR = 4.0  # so many times the variance of the surest path: paths beyond tell hardly anything more
NOTHING = np.zeros((3, 3))
ANYWHERE = np.diag([1e6, 1e6, 10.0])


class Skeleton:
    """Grows with the spots seen, not with the way driven: a robot that knows where it is leaves no knots behind.

    A knot is a keyframe. Every keyframe hangs on the knot from which it is known best, by what was driven since or by a loop.
    Knots are tied by what was driven between them, and by loops that make two of them surer of each other. Driving along
    known ways adds nothing, so less is known here than in the whole graph, never more.
    """

    def __init__(self, known_m: float, known_rad: float) -> None:
        """``known_m``, ``known_rad``: one sigma within which a spot is known."""
        self._known_m, self._known_rad = known_m, known_rad
        self._steps = array("d")  # of each step prev_T_body (3,) and its covariance (3, 3)
        self._loops: list[Edge] = []
        self._clear()

    def _clear(self) -> None:
        self._knots = array("q", [0])  # keyframes
        self._ties = _Ties()
        self._knot = array("q", [0])  # of each keyframe the number of that on which it hangs
        self._covariance = array("d", bytes(72))  # (3, 3) of each keyframe seen from there, in its tangent
        self._driven_m = 0.0  # since it was last asked whether the spot is known

    def __len__(self) -> int:
        return len(self._knots)

    @property
    def knots(self) -> IntArray:
        """(N,) keyframes."""
        return np.array(self._knots)

    # --- growing ------------------------------------------------------------------------------------

    def add_step(self, edges: Sequence[Edge], world_T_body: FloatArray, torn: bool = False) -> None:
        """The next keyframe, by match and wheels of the step to it. ``world_T_body`` (K, 3): all keyframes until then.
        ``torn``: nobody watched the robot on the way, and what the edges leave open is open."""
        known = sum((e.information for e in edges if e.kind != "heading"), NOTHING if torn else LEAST_KNOWN)
        covariance = np.linalg.inv(known)
        self._steps.extend([*edges[0].i_T_j.tolist(), *covariance.ravel().tolist()])
        self._take_step(world_T_body)

    def _take_step(self, world_T_body: FloatArray) -> None:
        j = len(self._knot)
        numbers = np.array(self._steps[12 * j - 12 : 12 * j])
        step, covariance = numbers[:3], numbers[3:].reshape(3, 3)
        self._covariance.extend((reach.carried(step, self._hanging(j - 1)) + covariance).ravel().tolist())
        self._knot.append(self._knot[-1])
        self._driven_m += float(np.hypot(step[0], step[1]))
        if self._driven_m >= SPACING_M:
            self._driven_m = 0.0
            if not self._is_known(j, world_T_body):
                self._make_knot(j)

    def _is_known(self, j: int, world_T_body: FloatArray) -> bool:
        """Whether there is a knot at the spot of keyframe j, and known well from there."""
        off = np.abs(se2.between(world_T_body[self._knots], world_T_body[j]))
        near = (np.hypot(off[:, 0], off[:, 1]) < SPACING_M) & (off[:, 2] < SAME_WAY_RAD)
        if not near.any():
            return False
        most = _cost(np.diag([self._known_m**2, 0.0, self._known_rad**2]))
        sigma_m, sigma_rad = self.seen_from(j, world_T_body, most)
        return bool((near & (sigma_m < self._known_m) & (sigma_rad < self._known_rad)).any())

    def add_loop(self, edge: Edge, world_T_body: FloatArray) -> None:
        """A loop between two of the keyframes ``world_T_body`` (K, 3)."""
        self._loops.append(edge)
        self._take_loop(edge, world_T_body)

    def _take_loop(self, edge: Edge, world_T_body: FloatArray) -> None:
        i, j = edge.i, edge.j
        a, b = self._knot[i], self._knot[j]
        if a == b:
            return
        over_loop = reach.carried(edge.i_T_j, self._hanging(i)) + np.linalg.inv(
            edge.information + LEAST_KNOWN
        )
        here = self._hanging(j)
        most = STRETCH * (_cost(over_loop) + _cost(here))
        if not np.isfinite(self._paths(b, world_T_body, most=most)[1][a]):
            is_new_way = b == len(self._knots) - 1
            if is_new_way or not self._is_known(j, world_T_body):
                self._make_knot(j)
                self._ties.add(a, self._knot[j], over_loop)
                return
            back = poses.between(world_T_body[j], world_T_body[self._knots[b]])
            self._ties.add(a, b, reach.carried(back, over_loop + here))
        if _cost(over_loop) < _cost(here):
            self._hang(j, a, over_loop)

    def without(self, loops: Sequence[Edge], world_T_body: FloatArray) -> None:
        """Make it anew without these loops, as a graph has decided that solved for ``world_T_body`` (K, 3)."""
        out = {(edge.i, edge.j) for edge in loops}
        self._loops = [edge for edge in self._loops if (edge.i, edge.j) not in out]
        later = sorted(self._loops, key=lambda edge: -max(edge.i, edge.j))
        self._clear()
        for j in range(1, len(self._steps) // 12 + 1):
            self._take_step(world_T_body)
            while later and max(later[-1].i, later[-1].j) == j:
                self._take_loop(later.pop(), world_T_body)

    def _make_knot(self, j: int) -> None:
        last = self._knot[j]
        if self._knots[last] == j:
            return
        self._ties.add(last, len(self._knots), self._hanging(j))
        self._hang(j, len(self._knots), NOTHING)
        self._knots.append(j)

    def _hang(self, j: int, knot: int, covariance: FloatArray) -> None:
        self._knot[j] = knot
        self._covariance[9 * j : 9 * j + 9] = array("d", covariance.ravel().tolist())

    def _hanging(self, j: int) -> FloatArray:
        """(3, 3) covariance of keyframe j seen from its knot, in its tangent."""
        return np.array(self._covariance[9 * j : 9 * j + 9]).reshape(3, 3)

    def knot_of(self, j: int) -> int:
        """The keyframe on which keyframe j hangs."""
        return self._knots[self._knot[j]]

    # --- what is known ------------------------------------------------------------------------------

    def seen_from(
        self, j: int, world_T_body: FloatArray, most: float = np.inf
    ) -> tuple[FloatArray, FloatArray]:
        """One-sigma position (m) and heading (rad), (N,) each, of all knots seen from keyframe j, along the surest path to
        each, if that costs at most ``most``: bounds of the joint marginals from above."""
        knot = self._knot[j]
        at_knot = poses.between(world_T_body[j], world_T_body[self._knots[knot]])
        covariances, _ = self._paths(knot, world_T_body, reach.carried(at_knot, self._hanging(j)), most)
        variances = np.diagonal(covariances, axis1=1, axis2=2)
        return np.sqrt(variances[:, 0] + variances[:, 1]), np.sqrt(variances[:, 2])

    def relative_covariance(self, i: int, j: int, world_T_body: FloatArray) -> FloatArray:
        """(3, 3) covariance of i_T_j, in its tangent, from the joint marginal by all ties that tell of it."""
        a, b = self._knot[i], self._knot[j]
        i_T_j = poses.between(world_T_body[i], world_T_body[j])
        out = reach.carried(i_T_j, self._hanging(i)) + self._hanging(j)
        if a != b:
            b_T_j = poses.between(world_T_body[self._knots[b]], world_T_body[j])
            out = out + reach.carried(b_T_j, self._between(a, b, world_T_body))
        return np.asarray(out)

    def _between(self, a: int, b: int, world_T_body: FloatArray) -> FloatArray:
        """(3, 3) covariance of knot b seen from knot a, in its tangent: the marginal of b while a stays where it is."""
        from_a = self._paths(a, world_T_body)[1]
        if not np.isfinite(from_a[b]):
            return ANYWHERE
        most = DETOUR * from_a[b]
        among = from_a + self._paths(b, world_T_body, most=most)[1] <= most
        among[a] = False
        row = np.where(among, np.cumsum(among) - 1, -1)
        ends, covariances = self._ties.as_arrays()
        ties = (among[ends] | (ends == a)).all(axis=1)
        i, j = ends[ties].T
        at_j = np.linalg.inv(covariances[ties])
        at = world_T_body[self._knots]
        by_i = -se2.adjoint(se2.between(at[j], at[i]))
        mixed = by_i.swapaxes(1, 2) @ at_j
        diagonal = np.zeros((int(among.sum()), 3, 3))
        np.add.at(diagonal, row[i][i != a], (mixed @ by_i)[i != a])
        np.add.at(diagonal, row[j][j != a], at_j[j != a])
        inner = (i != a) & (j != a)
        return np.asarray(inverse_diagonal(diagonal, row[i[inner]], row[j[inner]], mixed[inner])[row[b]])

    def _paths(
        self, start: int, world_T_body: FloatArray, covariance: FloatArray = NOTHING, most: float = np.inf
    ) -> tuple[FloatArray, FloatArray]:
        """`reach.path_covariances` from a knot that is itself known with ``covariance`` (3, 3)."""
        return self._ties.paths(start, covariance, world_T_body[self._knots], most)


class _Ties:
    """What ties knots: the covariance of the second seen from the first, in its tangent."""

    def __init__(self) -> None:
        self._ends = array("q")
        self._covariances = array("d")
        # the ties of a knot as a list that is linked through their ends (place h of _ends is end h)
        self._newest = array("q")  # end of each knot, -1: none
        self._older = array("q")  # for each end the one before it at the same knot

    def add(self, i: int, j: int, covariance: FloatArray) -> None:
        self._newest.extend([-1] * (max(i, j) + 1 - len(self._newest)))
        for knot in (i, j):
            self._older.append(self._newest[knot])
            self._newest[knot] = len(self._ends)
            self._ends.append(knot)
        self._covariances.extend(covariance.ravel().tolist())

    def as_arrays(self) -> tuple[IntArray, FloatArray]:
        """Ends (E, 2) and covariances (E, 3, 3)."""
        return np.array(self._ends).reshape(-1, 2), np.array(self._covariances).reshape(-1, 3, 3)

    def paths(
        self, start: int, covariance: FloatArray, poses: FloatArray, most: float
    ) -> tuple[FloatArray, FloatArray]:
        """`reach.path_covariances` among knots at ``poses`` (N, 3)."""
        ends, covariances = self.as_arrays()
        newest = np.full(len(poses), -1, np.int64)
        newest[: len(self._newest)] = self._newest
        older = np.array(self._older, np.int64)
        out: tuple[FloatArray, FloatArray] = reach.path_covariances(
            start, covariance, poses, newest, older, ends.ravel(), covariances, most
        )
        return out


def _cost(covariance: FloatArray) -> float:
    """Of a step of a path, as `reach.path_covariances` counts it."""
    return float(covariance[0, 0] + covariance[1, 1] + reach.LEVER_M**2 * covariance[2, 2])
