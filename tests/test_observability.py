"""Stretches in which scans leave a direction open, from edges made for it."""

from __future__ import annotations

import numpy as np
import pytest

from mfslam import se2
from mfslam.observability import open_stretches, tears, torn_covariances
from mfslam.types import Edge, FloatArray

SURE = np.diag([1e4, 1e4, 1e5])


def path_with(open_steps: dict[int, float], count: int = 20) -> tuple[FloatArray, list[Edge]]:
    """Keyframes along a bent path; a step k of ``open_steps`` is open along that heading of the world (rad)."""
    moves = [np.array([0.5, 0.0, 0.1])] * (count - 1)
    poses = [np.zeros(3)]
    for move in moves:
        poses.append(se2.compose(poses[-1], move))
    world = np.array(poses)
    edges = []
    for k in range(count - 1):
        information = SURE
        if k in open_steps:
            angle = open_steps[k] - world[k + 1, 2]
            across = np.array([-np.sin(angle), np.cos(angle), 0.0])
            information = 1e4 * np.outer(across, across) + np.diag([1.0, 1.0, 1e5])
        edges.append(Edge("scan", k, k + 1, moves[k], information))
    return world, edges


def test_a_run_of_steps_is_one_stretch_with_its_direction() -> None:
    world, edges = path_with(dict.fromkeys(range(4, 9), 2.0))
    edges.append(Edge("loop", 0, 15, se2.between(world[0], world[15]), np.eye(3)))  # only scans' steps count
    scans = 3 * np.arange(len(world))
    (stretch,) = open_stretches(world, scans, edges)
    assert (stretch.first_scan, stretch.last_scan) == (12, 27)
    assert stretch.travelled_m == pytest.approx(2.5, abs=0.01)
    assert np.cos(2.0 * (stretch.direction_rad - 2.0)) == pytest.approx(1.0, abs=1e-6)
    assert abs(stretch.direction_rad) <= 0.5 * np.pi


def test_another_direction_or_a_long_gap_begins_another_stretch() -> None:
    turned = {k: 0.0 if k < 6 else 1.2 for k in range(3, 9)}
    world, edges = path_with(turned | {12: 0.0, 14: 0.0})
    found = open_stretches(world, np.arange(len(world)), edges)
    assert [(s.first_scan, s.last_scan) for s in found] == [(3, 6), (6, 9), (12, 15)]


def test_nothing_open_nothing_found() -> None:
    world, edges = path_with({})
    assert open_stretches(world, np.arange(len(world)), edges) == []
    assert open_stretches(world[:1], np.zeros(1, np.int64), []) == []


def torn_path(sigma_m: float) -> tuple[FloatArray, list[Edge]]:
    """Ten steps of 1 m along x, the fifth of which nothing but inertia tells."""
    world = np.column_stack([np.arange(11.0), np.zeros(11), np.zeros(11)])
    step = np.array([1.0, 0.0, 0.0])
    loose = np.diag([sigma_m**-2, sigma_m**-2, 1.0])
    return world, [Edge("scan", k, k + 1, step, loose if k == 4 else SURE) for k in range(10)]


def test_a_step_that_nothing_tells_tears_the_path_and_what_follows_is_as_unsure() -> None:
    world, edges = torn_path(2.0)
    assert list(tears(edges)) == [5]
    added = torn_covariances(world, edges)
    assert not added[:5].any()
    np.testing.assert_allclose(added[5], np.diag([4.0, 4.0, 1.0]), rtol=1e-4)
    # 5 m on, the heading's error has moved the pose sideways
    np.testing.assert_allclose(added[10, 1, 1], 4.0 + 5.0**2, rtol=1e-4)
    assert tears(torn_path(0.3)[1]) == {
        5: pytest.approx(np.diag([0.09, 0.09, 1.0]), rel=1e-3)
    }  # by its heading


def test_wheels_or_a_loop_in_use_mend_it() -> None:
    world, edges = torn_path(2.0)
    assert tears([*edges, Edge("odometry", 4, 5, edges[4].i_T_j, SURE)]) == {}
    over = Edge("loop", 2, 8, np.array([6.0, 0.0, 0.0]), SURE)
    assert tears([*edges, over]) == {}
    assert list(tears([*edges, Edge("loop", 2, 8, over.i_T_j, SURE, weight=0.0)])) == [5]
    assert list(
        tears([*edges, Edge("loop", 5, 9, over.i_T_j, SURE), Edge("loop", 0, 4, over.i_T_j, SURE)])
    ) == [5]
    assert tears([]) == {} and not torn_covariances(world, []).any()
