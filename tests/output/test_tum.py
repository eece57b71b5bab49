from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mfslam import se2
from mfslam.output.tum import read_tum, stamp_from_text, stamp_text, trajectory_text
from mfslam.types import MfslamError

stamps = st.integers(-(2**62), 2**62)
poses = st.tuples(st.floats(-1e4, 1e4), st.floats(-1e4, 1e4), st.floats(-3.14159, 3.14159))


@given(stamps)
def test_stamps_survive_exactly(stamp_ns: int) -> None:
    assert stamp_from_text(stamp_text(stamp_ns)) == stamp_ns


@given(st.integers(0, 2_000_000_000_000_000))
def test_a_stamp_reads_as_the_float_that_the_log_wrote(microseconds: int) -> None:
    log_text = f"{microseconds // 1_000_000}.{microseconds % 1_000_000:06d}"
    assert float(stamp_text(stamp_from_text(log_text))) == float(log_text)


@given(st.lists(st.tuples(stamps, poses), min_size=1, max_size=20))
def test_round_trip(
    tmp_path_factory: pytest.TempPathFactory, rows: list[tuple[int, tuple[float, float, float]]]
) -> None:
    path = tmp_path_factory.getbasetemp() / "round.tum"
    stamps_ns = np.array([row[0] for row in rows], dtype=np.int64)
    world_T_body = np.array([row[1] for row in rows])
    path.write_text(trajectory_text(stamps_ns, world_T_body))
    again_ns, again = read_tum(path)
    np.testing.assert_array_equal(again_ns, stamps_ns)
    np.testing.assert_allclose(again[:, :2], world_T_body[:, :2], atol=1e-9)
    assert np.abs(se2.wrap(again[:, 2] - world_T_body[:, 2])).max() < 1e-9


@given(st.text(max_size=60))
def test_any_text_is_read_or_refused_in_one_line(tmp_path_factory: pytest.TempPathFactory, text: str) -> None:
    path = tmp_path_factory.getbasetemp() / "any.tum"
    path.write_text(text, encoding="utf-8", newline="")
    with pytest.raises(MfslamError) as caught:
        read_tum(path)
    assert "expected" in str(caught.value)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("1.0 2 3 0 0 0 1", r":2: expected 'stamp x y z qx qy qz qw'"),
        ("1.0 2 3 0 0 0 0 1 9", r":2: expected 'stamp x y z qx qy qz qw'"),
        ("1.0 2 x 0 0 0 0 1", r":2: expected 'stamp"),
        ("nan 2 3 0 0 0 0 1", r":2: expected 'stamp"),
        ("1.0 2 nan 0 0 0 0 1", r":2: expected finite numbers"),
        ("1.0 2 3 0 0 0 0 0", r":2: expected a unit quaternion, got length 0"),
    ],
)
def test_errors_name_the_line(tmp_path: Path, line: str, message: str) -> None:
    path = tmp_path / "t.tum"
    path.write_text(f"# comment\n{line}\n")
    with pytest.raises(MfslamError, match=message):
        read_tum(path)


def test_missing_and_binary_files(tmp_path: Path) -> None:
    with pytest.raises(MfslamError, match="no such file"):
        read_tum(tmp_path / "none.tum")
    (tmp_path / "b.tum").write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(MfslamError, match="binary data"):
        read_tum(tmp_path / "b.tum")
