from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mfslam.output.covariance import covariances_text, read_covariances
from mfslam.types import MfslamError


@given(st.lists(st.tuples(st.integers(-(2**62), 2**62), st.integers(0, 2**31)), min_size=1, max_size=10))
def test_round_trip(tmp_path_factory: pytest.TempPathFactory, rows: list[tuple[int, int]]) -> None:
    roots = np.array([np.random.default_rng(seed).normal(size=(3, 3)) for _, seed in rows])
    covariances = 1e-3 * roots @ np.swapaxes(roots, 1, 2)
    path = tmp_path_factory.getbasetemp() / "round.cov"
    path.write_text(covariances_text(np.array([stamp for stamp, _ in rows], dtype=np.int64), covariances))
    stamps_ns, again = read_covariances(path)
    assert stamps_ns.tolist() == [stamp for stamp, _ in rows]
    np.testing.assert_allclose(again, covariances, rtol=1e-6)
    np.testing.assert_array_equal(again, np.swapaxes(again, 1, 2))


@pytest.mark.parametrize("line", ["1.0 1 2 3", "1.0 1 2 3 4 5 nan", "x 1 2 3 4 5 6", "1.0 1 2 3 4 5 6 7", ""])
def test_anything_else_is_refused_by_line(tmp_path: Path, line: str) -> None:
    path = tmp_path / "bad.cov"
    path.write_text(f"# a comment\n{line}\n")
    where = rf"bad\.cov:2: expected 'stamp xx .*got '{line}'" if line else "holds no covariance"
    with pytest.raises(MfslamError, match=where):
        read_covariances(path)
