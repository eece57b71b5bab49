"""The order of elimination and the pattern: every given block finds its slot, and marginals are those of dense algebra."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from mfslam.kernels import block_cholesky
from mfslam.sparse_blocks import Pattern


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000), count=st.integers(2, 15), links=st.integers(0, 12))
def test_solutions_and_marginals_of_any_pattern_are_those_of_dense_algebra(
    seed: int, count: int, links: int
) -> None:
    rng = np.random.default_rng(seed)
    pairs = [(k, k + 1) for k in range(count - 1)]
    pairs += [tuple(rng.choice(count, 2, replace=False).tolist()) for _ in range(links)]
    i, j = np.array(pairs, dtype=np.int64).T
    pattern = Pattern.of(i, j, count)
    place = pattern.place
    dense = 1e-2 * np.eye(3 * count)
    diagonal = np.tile(1e-2 * np.eye(3), (count, 1, 1))
    below = np.zeros((len(pattern.rows), 3, 3))
    for n, (a, b) in enumerate(pairs):
        late, early = max(place[a], place[b]), min(place[a], place[b])
        row = np.zeros((3, 3 * count))
        row[:, 3 * late : 3 * late + 3], row[:, 3 * early : 3 * early + 3] = rng.normal(size=(2, 3, 3))
        term = row.T @ row
        dense += term
        for k in (late, early):
            diagonal[k] += term[3 * k : 3 * k + 3, 3 * k : 3 * k + 3]
        below[pattern.slots[n]] += term[3 * late : 3 * late + 3, 3 * early : 3 * early + 3]
    block_cholesky.factorise(pattern.first, pattern.rows, diagonal, below)
    rhs = rng.normal(size=(count, 3))
    x = rhs.copy()
    block_cholesky.substitute(pattern.first, pattern.rows, diagonal, below, x)
    np.testing.assert_allclose(dense @ x.ravel(), rhs.ravel(), atol=1e-7)
    block_cholesky.invert_selected(pattern.first, pattern.rows, diagonal, below)
    inverse = np.linalg.inv(dense)
    for k in range(count):
        block = inverse[3 * k : 3 * k + 3, 3 * k : 3 * k + 3]
        np.testing.assert_allclose(diagonal[k], block, rtol=1e-6, atol=1e-7)
