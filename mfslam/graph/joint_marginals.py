"""Joint marginals of two keyframes, from a factor that lags behind the graph.

Keyframes that came since are carried on along the chain of steps; loops that came since are taken in one by one
(Woodbury's identity), each at the price of a path up the elimination tree. So a marginal costs nothing of the graph's
size, and is exact for the linearised graph.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mfslam import se2
from mfslam.graph.least_squares import Factor
from mfslam.kernels import block_cholesky, poses
from mfslam.types import FloatArray, IntArray

MOST_LOOPS, MOST_STEPS = 30, 300  # that are taken in; more of either are worth a new factor


@dataclass(frozen=True, eq=False, slots=True)
class _Motion:
    """A linear function (3,) of the errors of all poses: its paths in the factor, and what multiplies the errors of the
    steps (N, 3, 3) that came after it."""

    path: IntArray
    blocks: FloatArray
    steps: FloatArray


class JointMarginals:
    """Of the poses (K, 3) as they stand; ``factor``: of the first ones of them."""

    def __init__(self, factor: Factor, world_T_body: FloatArray) -> None:
        self._factor = factor
        self._count = len(factor.place)
        self._world_T_body = world_T_body
        self._steps = np.empty((0, 3, 3))  # covariance of each step after the factor
        self._new_steps: list[FloatArray] = []  # information of those that no marginal was asked for since
        self._loops: list[_Motion] = []
        self._new_loops: list[tuple[int, int, FloatArray]] = []  # and loops likewise
        self._among_loops = np.empty((0, 0))

    def is_old(self) -> bool:
        return (
            len(self._loops) + len(self._new_loops) > MOST_LOOPS
            or len(self._steps) + len(self._new_steps) > MOST_STEPS
        )

    def add_step(self, world_T_body: FloatArray, information: FloatArray) -> None:
        """The next keyframe: all poses (K, 3), and the (3, 3) information of the step to the last one."""
        self._world_T_body = world_T_body
        self._new_steps.append(information)

    def add_loop(self, i: int, j: int, information: FloatArray) -> None:
        """A loop between two of the poses, and its (3, 3) information."""
        self._new_loops.append((i, j, information))

    def _take_in(self, i: int, j: int, information: FloatArray) -> None:
        loop = self._motion(i, j)
        count = len(self._loops)
        among = np.zeros((3 * count + 3, 3 * count + 3))
        among[:-3, :-3] = self._among_loops
        for n, other in enumerate([*self._loops, loop]):
            shared = self._product(other, loop)
            among[3 * n : 3 * n + 3, -3:] = shared
            among[-3:, 3 * n : 3 * n + 3] = shared.T
        among[-3:, -3:] += np.linalg.inv(information)
        self._loops.append(loop)
        self._among_loops = among

    def relative(self, i: int, j: int) -> FloatArray:
        """(3, 3) covariance of i_T_j in its tangent."""
        for loop in self._new_loops:
            self._take_in(*loop)
        self._new_loops = []
        motion = self._motion(i, j)
        out = self._product(motion, motion)
        if self._loops:
            shared = np.concatenate([self._product(loop, motion) for loop in self._loops])
            out = out - shared.T @ np.linalg.solve(self._among_loops, shared)
        return np.asarray(out)

    def _motion(self, i: int, j: int) -> _Motion:
        """The error of i_T_j: that of j, less that of i carried there."""
        if self._new_steps:
            self._steps = np.concatenate([self._steps, np.linalg.inv(self._new_steps)])
            self._new_steps = []
        by_i = -_carried(self._world_T_body, i, j)
        at: dict[int, FloatArray] = {}
        steps = np.zeros_like(self._steps)
        for keyframe, by_pose in ((i, by_i), (j, np.eye(3))):
            last = min(keyframe, self._count - 1)
            if last > 0:  # the first pose has no error
                of_last = by_pose @ _carried(self._world_T_body, last, keyframe)
                at[last] = at.get(last, np.zeros((3, 3))) + of_last
            if keyframe > last:
                after = self._world_T_body[last + 1 : keyframe + 1]
                carried = se2.adjoint(se2.between(self._world_T_body[keyframe], after))
                steps[: keyframe - last] += by_pose @ carried
        rows = self._factor.place[list(at)].astype(np.int64)
        given = np.array([by_pose.T for by_pose in at.values()]).reshape(-1, 3, 3)
        pattern = self._factor.pattern
        path, blocks = block_cholesky.path_columns(
            pattern.first, pattern.rows, self._factor.below, rows, given
        )
        return _Motion(path, blocks, steps)

    def _product(self, a: _Motion, b: _Motion) -> FloatArray:
        """(3, 3) covariance of two motions."""
        out: FloatArray = block_cholesky.path_product(
            a.path, a.blocks, b.path, b.blocks, self._factor.diagonal
        )
        n = min(len(a.steps), len(b.steps))
        if n:
            out = out + (a.steps[:n] @ self._steps[:n] @ b.steps[:n].swapaxes(1, 2)).sum(axis=0)
        return out


def _carried(world_T_body: FloatArray, a: int, b: int) -> FloatArray:
    """Adjoint (3, 3) that carries an error of pose a into the frame of pose b."""
    return se2.adjoint(poses.between(world_T_body[b], world_T_body[a]))
