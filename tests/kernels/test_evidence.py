"""Occupied, free, unknown: drawn from a few rays by hand."""

import numpy as np

from mfslam.kernels import evidence

CELL_M = 0.1


def grid_of(origins, rays, rows=5, cols=20):
    """``rays``: for every origin the end points of its rays."""
    first = np.cumsum([0] + [len(r) for r in rays]).astype(np.int64)
    points = np.array([p for r in rays for p in r], dtype=float).reshape(-1, 2)
    return evidence.evidence_grid(
        np.array(origins, dtype=float), first, points, np.zeros(2), rows, cols, CELL_M
    )


def test_a_ray_is_free_up_to_two_cells_before_its_end():
    """Two rays along a row of cells, from the middle of cell 1 to the middle of cell 12."""
    grid = grid_of([[0.15, 0.25]], [[[1.25, 0.25], [1.25, 0.25]]])
    expected = np.zeros((5, 20), int)
    expected[2, 1:10] = evidence.FREE
    expected[2, 12] = evidence.OCCUPIED
    np.testing.assert_array_equal(grid, expected)


def test_one_ray_frees_nothing_and_a_hit_outweighs_passes():
    grid = grid_of([[0.15, 0.25], [0.15, 0.25]], [[[1.85, 0.25]], [[0.75, 0.25], [1.85, 0.25]]])
    assert grid[2, 3] == evidence.FREE, "passed by all"
    assert grid[2, 7] == evidence.OCCUPIED, "passed by two, but one ended here"
    single = grid_of([[0.15, 0.25]], [[[1.85, 0.25]]])
    assert evidence.FREE not in single


def test_rays_may_start_and_end_outside_of_the_grid():
    grid = grid_of([[-1.0, 0.25]], [[[3.0, 0.25], [3.0, 0.25]]])
    assert np.all(grid[2] == evidence.FREE)
    assert not grid[[0, 1, 3, 4]].any()
    assert not grid_of([[0.15, 0.25]], [[[0.15, 0.25]]])[2, 0], "a ray of no length frees nothing"


def test_agreement_counts_hits_contradictions_and_all():
    grid = np.zeros((10, 10), np.uint8)
    grid[:, 2:6] = evidence.FREE
    grid[:, 7] = evidence.OCCUPIED
    points = np.array(
        [
            [0.75, 0.55],  # on the wall
            [0.85, 0.55],  # beside it
            [0.45, 0.55],  # in the open
            [0.15, 0.55],  # unknown
            [5.0, 0.5],  # outside
            [-0.05, 0.5],  # outside, below zero
        ]
    )
    assert evidence.agreement(grid, np.zeros(2), CELL_M, np.zeros(3), points) == (2, 1, 6)
    shifted = np.array([0.3, 0.0, 0.0])
    assert evidence.agreement(grid, np.zeros(2), CELL_M, shifted, points) == (1, 2, 6)


def test_agreement_turns_the_points():
    grid = np.zeros((10, 10), np.uint8)
    grid[8, 3] = evidence.OCCUPIED
    quarter = np.array([0.35, 0.05, np.pi / 2])
    assert evidence.agreement(grid, np.zeros(2), CELL_M, quarter, np.array([[0.8, 0.0]])) == (1, 0, 1)
