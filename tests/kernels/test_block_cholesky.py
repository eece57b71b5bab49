"""The sparse factor and its selected inverse against dense algebra."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from mfslam.kernels import block_cholesky
from mfslam.types import FloatArray


def random_matrix(rng: np.random.Generator, count: int, links: int) -> FloatArray:
    """A sparse positive definite matrix of 3x3 blocks: a chain and some links across it."""
    pairs = [(k, k + 1) for k in range(count - 1)]
    pairs += [tuple(sorted(rng.choice(count, 2, replace=False))) for _ in range(links)]
    out = 1e-3 * np.eye(3 * count)
    for i, j in pairs:
        row = np.zeros((3, 3 * count))
        row[:, 3 * i : 3 * i + 3], row[:, 3 * j : 3 * j + 3] = rng.normal(size=(2, 3, 3))
        out += row.T @ row
    return out


def block(matrix: FloatArray, i: int, j: int) -> FloatArray:
    return matrix[3 * i : 3 * i + 3, 3 * j : 3 * j + 3]


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000), count=st.integers(2, 12), links=st.integers(0, 10))
def test_blocks_in_the_pattern_are_those_of_the_inverse(seed: int, count: int, links: int) -> None:
    matrix = random_matrix(np.random.default_rng(seed), count, links)
    left = [[j for j in range(i) if block(matrix, i, j).any()] for i in range(count)]
    starts = np.cumsum([0, *map(len, left)])
    columns = np.array([j for row in left for j in row], dtype=np.int64)
    first, rows = block_cholesky.factor_pattern(starts, columns)
    of_column = np.repeat(np.arange(count), np.diff(first))
    diagonal = np.array([block(matrix, k, k) for k in range(count)])
    below = np.array([block(matrix, i, j) for i, j in zip(rows, of_column, strict=True)]).reshape(-1, 3, 3)
    block_cholesky.factorise(first, rows, diagonal, below)
    lower = np.eye(3 * count)
    d = np.zeros_like(lower)
    for k in range(count):
        block(d, k, k)[:] = np.linalg.inv(diagonal[k])
    for i, j, value in zip(rows, of_column, below, strict=True):
        block(lower, i, j)[:] = value
    assert np.allclose(lower @ d @ lower.T, matrix)
    block_cholesky.invert_selected(first, rows, diagonal, below)
    inverse = np.linalg.inv(matrix)
    scale = np.abs(inverse).max()
    for k in range(count):
        assert np.allclose(diagonal[k], block(inverse, k, k), atol=1e-7 * scale)
    for i, j, value in zip(rows, of_column, below, strict=True):
        assert np.allclose(value, block(inverse, i, j), atol=1e-7 * scale)
