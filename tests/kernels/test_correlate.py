"""Branch and bound finds what an exhaustive search finds."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mfslam.kernels import correlate

CELL_M = 0.1


def test_likelihood_is_a_gaussian_of_the_distance_to_the_nearest_point():
    points = np.array([[0.52, 0.47], [0.95, 0.12]])
    grid = correlate.likelihood_grid(points, np.zeros(2), 12, 14, CELL_M, 0.1)
    y, x = np.mgrid[0:12, 0:14] * CELL_M + 0.5 * CELL_M
    d2 = np.min([(x - px) ** 2 + (y - py) ** 2 for px, py in points], axis=0)
    expected = np.floor(255.0 * np.exp(-d2 / (2.0 * 0.1**2)))
    near = d2 < (2.0 * 0.1) ** 2
    np.testing.assert_allclose(grid[near], expected[near], atol=1)
    assert not grid[d2 > 0.4**2].any()


@settings(max_examples=30, deadline=None, derandomize=True)
@given(st.integers(0, 10_000), st.integers(1, 5))
def test_a_level_bounds_every_cell_of_its_block(seed, levels):
    grid = np.random.default_rng(seed).integers(0, 256, (13, 17)).astype(np.uint8)
    stack, pad = correlate.pyramid(grid, levels), 1 << (levels - 1)
    padded = np.zeros((13 + 3 * pad, 17 + 3 * pad), np.uint8)
    padded[pad : pad + 13, pad : pad + 17] = grid
    for h in range(levels):
        for i in range(pad + 14):
            for j in range(pad + 18):
                assert stack[h, i, j] == padded[i : i + (1 << h), j : j + (1 << h)].max()
    assert not (stack[:, [0, -1]].any() or stack[:, :, [0, -1]].any())


def exhaustive(grid, origin, points, center, angles, half_window, levels):
    """Best share over all shifts that the blocks of the search cover, one cell at a time."""
    half, block = math.ceil(half_window / CELL_M), 1 << (levels - 1)
    last = -half + ((2 * half) // block + 1) * block
    scores = {}
    for angle in angles:
        c, s = math.cos(center[2] + angle), math.sin(center[2] + angle)
        x = np.floor((center[0] + c * points[:, 0] - s * points[:, 1] - origin[0]) / CELL_M).astype(int)
        y = np.floor((center[1] + s * points[:, 0] + c * points[:, 1] - origin[1]) / CELL_M).astype(int)
        for ox in range(-half, last):
            for oy in range(-half, last):
                u, v = x + ox, y + oy
                inside = (u >= 0) & (v >= 0) & (u < grid.shape[1]) & (v < grid.shape[0])
                score = int(grid[v[inside], u[inside]].astype(int).sum()) / (255.0 * len(points))
                scores[(center[0] + ox * CELL_M, center[1] + oy * CELL_M, center[2] + angle)] = score
    return scores


@settings(max_examples=40, deadline=None, derandomize=True)
@given(
    st.integers(0, 100_000),
    st.integers(1, 4),
    st.floats(0.05, 0.75),
    st.floats(0.0, 0.6),
    st.integers(1, 4),
    st.floats(0.5, 1.0),
)
def test_search_is_exhaustive(seed, levels, half_window, min_score, most, rival_share):
    """Random grids and points, partly outside of the grid: the same best scores, one after the other, and poses that have them."""
    rng = np.random.default_rng(seed)
    grid = (rng.integers(0, 256, (15, 12)) * (rng.random((15, 12)) < 0.4)).astype(np.uint8)
    points = rng.uniform(-0.7, 0.9, (8, 2))
    center, origin = np.array([0.6, 0.7, rng.uniform(-3.0, 3.0)]), np.array([-0.05, 0.03])
    angles = np.array([-0.2, 0.0, 0.2])  # all are within half a rad of each other
    scores = exhaustive(grid, origin, points, center, angles, half_window, levels)
    poses, found = correlate.branch_and_bound(
        correlate.pyramid(grid, levels), origin, CELL_M, points, center, angles, half_window, min_score,
        most, rival_share, 0.15,
    )  # fmt: skip
    least = min_score
    for k in range(most):
        best = max(scores.values(), default=0.0)
        if best <= least:
            assert len(found) == len(poses) == k
            return
        assert found[k] == pytest.approx(best, abs=1e-12)
        nearest = min(scores, key=lambda p: float(np.abs(np.array(p) - poses[k]).sum()))
        np.testing.assert_allclose(nearest, poses[k], atol=1e-12)
        assert scores[nearest] == pytest.approx(best, abs=1e-12)
        scores = {p: s for p, s in scores.items() if math.dist(p[:2], nearest[:2]) >= 0.15}
        least = rival_share * found[0]
    assert len(found) == most
