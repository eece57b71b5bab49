"""False loops for a pose graph, by seed."""

from __future__ import annotations

from typing import Literal

import numpy as np

from mfslam import se2
from mfslam.pose_graphs.data import Problem
from mfslam.types import BoolArray, FloatArray, IntArray

Kind = Literal["uniform", "grouped"]
GROUP = 10  # loops of a group: a stretch of the path taken for another one
APART = 20  # poses at least between the ends of a false loop


def with_false_loops(
    problem: Problem, world_T_pose: FloatArray, share: float, kind: Kind, seed: int
) -> tuple[Problem, BoolArray]:
    """The graph with false loops that make up ``share`` of its loops, and which edges (E,) they are.

    A false loop says of two poses chosen at random what a true loop says of its own two. Those of a group
    go on along the path, each as the shape of the path at ``world_T_pose`` (N, 3) has it, with the noise of
    its information: they agree with one another.
    """
    rng = np.random.default_rng(seed)
    loops = np.flatnonzero(~problem.chain())
    wanted = round(len(loops) * share / (1.0 - share))
    heads: list[IntArray] = []
    tails: list[IntArray] = []
    poses: list[FloatArray] = []
    models: list[IntArray] = []
    while sum(map(len, heads)) < wanted:
        length = 1 if kind == "uniform" else GROUP
        i, j = rng.integers(0, problem.size - length, 2)
        if abs(i - j) < APART + length:
            continue
        model = int(rng.choice(loops))
        first = problem.i_T_j[model]
        i_k, j_k = i + np.arange(length), j + np.arange(length)
        # where the stretch of j would lie if the first loop were true
        moved = se2.compose(
            se2.compose(world_T_pose[i], first), se2.between(world_T_pose[j], world_T_pose[j_k])
        )
        noise = rng.multivariate_normal(np.zeros(3), np.linalg.inv(problem.information[model]), size=length)
        noise[0] = 0.0
        heads.append(i_k)
        tails.append(j_k)
        poses.append(se2.compose(se2.between(world_T_pose[i_k], moved), se2.exp(noise)))
        models.append(np.full(length, model))
    count = slice(0, wanted)
    more = [np.concatenate(part)[count] for part in (heads, tails, poses, models)] if wanted else None
    if more is None:
        return problem, np.zeros(len(problem.i), dtype=np.bool_)
    out = Problem(
        problem.world_T_pose,
        np.concatenate([problem.i, more[0]]),
        np.concatenate([problem.j, more[1]]),
        np.concatenate([problem.i_T_j, more[2]]),
        np.concatenate([problem.information, problem.information[more[3]]]),
        problem.held,
    )
    return out, np.arange(len(out.i)) >= len(problem.i)
