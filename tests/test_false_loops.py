"""Robust solves: single steps, and groups of false loops that agree with one another."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mfslam import se2
from mfslam.graph.batch import solve
from mfslam.graph.gauss_newton import step
from mfslam.graph.robust import solve_robust
from mfslam.graph.robust_starts import drift
from mfslam.metrics import ate
from mfslam.pose_graphs.data import GraphFile, Problem, problem_of
from mfslam.types import FloatArray, MfslamError

SIGMAS = np.array([0.03, 0.03, 0.01])


def laps(count: int = 120, lap: int = 40, seed: int = 0) -> tuple[Problem, FloatArray]:
    """Laps of a square, every pose joined to the one a lap before; and the truth. Row 40 is the first loop."""
    rng = np.random.default_rng(seed)
    k = np.arange(count)
    side, along = (k // (lap // 4)) % 4, k % (lap // 4)
    corner = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])[side]
    heading = side * 0.5 * np.pi
    truth = np.column_stack([
        corner[:, 0] + along * np.cos(heading), corner[:, 1] + along * np.sin(heading), se2.wrap(heading),
    ])  # fmt: skip
    i = np.concatenate([k[:-1], k[:-lap]])
    j = np.concatenate([k[1:], k[lap:]])
    measured = se2.compose(se2.between(truth[i], truth[j]), se2.exp(rng.normal(size=(len(i), 3)) * SIGMAS))
    information = np.tile(np.diag(SIGMAS**-2.0), (len(i), 1, 1))
    return problem_of(GraphFile(k, truth, frozenset(), i, j, measured, information))[0], truth


def with_groups(problem: Problem, truth: FloatArray, groups: int, size: int, seed: int) -> Problem:
    """Groups of false loops: a stretch of the path said to lie beside another one, all of a group alike."""
    rng = np.random.default_rng(seed)
    run = np.arange(size)
    i, j, told = [], [], []
    for _ in range(groups):
        a = int(rng.integers(0, problem.size - 25 - size))
        b = int(rng.integers(a + 20, problem.size - size))
        beside = se2.compose(truth[a], np.append(rng.uniform(-3, 3, 2), rng.uniform(-3, 3)))
        moved = se2.compose(beside, se2.between(truth[b], truth[b + run]))
        noise = se2.exp(rng.normal(size=(size, 3)) * SIGMAS)
        i.append(a + run)
        j.append(b + run)
        told.append(se2.compose(se2.between(truth[a + run], moved), noise))
    return replace(
        problem,
        i=np.concatenate([problem.i, *i]),
        j=np.concatenate([problem.j, *j]),
        i_T_j=np.concatenate([problem.i_T_j, *told]),
        information=np.concatenate(
            [problem.information, np.tile(np.diag(SIGMAS**-2.0), (groups * size, 1, 1))]
        ),
    )


def _error_m(truth: FloatArray, poses: FloatArray) -> float:
    return float(ate(truth, poses).translation_m.rmse)


def test_steps_come_to_the_poses_of_a_batch_solve() -> None:
    problem, truth = laps()
    poses, ones = truth, np.ones(len(problem.i))
    for _ in range(6):
        poses = step(problem, poses, ones)
    batch = solve(problem, truth)
    assert problem.chi2(poses).sum() == pytest.approx(problem.chi2(batch.world_T_pose).sum(), rel=1e-5)
    assert np.array_equal(poses[0], truth[0])


def test_a_step_without_the_edges_of_a_pose_is_refused() -> None:
    problem, truth = laps()
    with pytest.raises(MfslamError, match="leave a pose open"):
        step(problem, truth, np.where((problem.i == 50) | (problem.j == 50), 0.0, 1.0))


def test_drift_is_that_of_the_steps_between() -> None:
    """Along a straight line of n steps: variances n s^2, and across it the lever arms of the turns."""
    count = 6
    truth = np.column_stack([np.arange(count, dtype=float), np.zeros(count), np.zeros(count)])
    i, j = np.append(np.arange(count - 1), 1), np.append(np.arange(1, count), 4)
    information = np.tile(np.diag(SIGMAS**-2.0), (len(i), 1, 1))
    graph = GraphFile(
        np.arange(count), truth, frozenset(), i, j, se2.between(truth[i], truth[j]), information
    )
    found = drift(problem_of(graph)[0], truth)[-1]
    s_xy, s_theta = SIGMAS[0] ** 2, SIGMAS[2] ** 2
    levers = np.array([2.0, 1.0, 0.0])  # from the end of each step to pose 4, m
    expected = np.diag([3 * s_xy, 3 * s_xy + s_theta * (levers**2).sum(), 3 * s_theta])
    expected[1, 2] = expected[2, 1] = s_theta * levers.sum()
    assert np.allclose(found, expected, rtol=1e-6)


@pytest.mark.parametrize(("groups", "size"), [(27, 3), (8, 10), (4, 20)])
def test_as_many_false_loops_as_true_ones_in_groups_that_agree(groups: int, size: int) -> None:
    problem, truth = laps()
    solved = solve_robust(with_groups(problem, truth, groups, size, seed=groups), truth)
    false = np.arange(len(solved.weights)) >= len(problem.i)
    assert (solved.weights[false] == 0).all()
    assert solved.weights[~false].mean() > 0.95
    assert _error_m(truth, solved.world_T_pose) < 1.1 * _error_m(truth, solve(problem, truth).world_T_pose)


def test_noise_much_smaller_than_the_file_says_hides_no_false_loops() -> None:
    problem, truth = laps()
    spoiled = with_groups(problem, truth, 8, 10, seed=3)
    wide = replace(spoiled, information=spoiled.information / 100.0)
    solved = solve_robust(wide, truth)
    assert (solved.weights[len(problem.i) :] == 0).all()
    assert _error_m(truth, solved.world_T_pose) < 1.1 * _error_m(truth, solve(problem, truth).world_T_pose)
