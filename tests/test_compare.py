"""Two runs side by side."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from mfslam import se2
from mfslam.cli import main
from mfslam.config import Config
from mfslam.output import write_run
from mfslam.types import Edge, Findings, FloatArray, OccupancyGrid, PointCloud, RunResult

NS = 1_000_000_000


def write(
    folder: Path, poses: FloatArray, walls: list[tuple[int, int]], loops: list[tuple[int, int]]
) -> Path:
    count = len(poses)
    occupancy = np.zeros((20, 30), dtype=np.int8)
    for row, column in walls:
        occupancy[row, column] = 100
    edges = [Edge("scan", n, n + 1, se2.between(poses[n], poses[n + 1]), np.eye(3)) for n in range(count - 1)]
    edges += [Edge("loop", i, j, se2.between(poses[i], poses[j]), np.eye(3)) for i, j in loops]
    result = RunResult(
        np.arange(count, dtype=np.int64) * NS, poses, np.arange(count), edges,
        OccupancyGrid(np.array([-1.0, -1.0]), 0.1, occupancy),
        PointCloud(np.zeros((1, 2)), np.zeros(1, dtype=np.int64)), Findings(), np.zeros((count, 3, 3)),
        summary={"timings_s": {"map": 1.0 + len(loops)}},
    )  # fmt: skip
    folder.mkdir()
    write_run(result, Config(), folder)
    return folder


@pytest.fixture
def poses() -> FloatArray:
    return np.column_stack(
        [np.linspace(0, 1, 40), 0.2 * np.sin(np.linspace(0, 6, 40)), np.linspace(0, 1, 40)]
    )


def test_what_changed_is_told(tmp_path: Path, poses: FloatArray, capsys: pytest.CaptureFixture[str]) -> None:
    a = write(tmp_path / "a", poses, [(5, c) for c in range(20)], [(0, 30), (2, 35)])
    moved = poses.copy()
    moved[20:, 1] += 0.05
    b = write(tmp_path / "b", moved, [(5, c) for c in range(10)] + [(15, c) for c in range(5)], [(0, 30)])
    found, page, picture = tmp_path / "c.json", tmp_path / "c.html", tmp_path / "c.png"
    assert (
        main(["compare", str(a), str(b), "--json", str(found), "-o", str(page), "--picture", str(picture)])
        == 0
    )
    data = json.loads(found.read_text())
    assert data["loops"] == {"a": 2, "b": 1, "common": 1, "only_a": 1, "only_b": 0}
    assert data["trajectories"]["common"] == 40
    assert data["trajectories"]["as_they_are"]["translation_m"]["max"] == pytest.approx(0.05)
    assert data["trajectories"]["aligned"]["translation_m"]["mean"] < 0.05
    assert data["maps"]["walls_a"] == 20
    assert 0.5 <= data["maps"]["shared_of_a"] < 0.7
    assert data["summary"]["timings_s.map"] == {"a": 3.0, "b": 2.0, "change": -1.0}
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert "data:image/png;base64," in page.read_text()
    told = capsys.readouterr().out
    assert "timings map, s" in told
    assert "-33.3 %" in told


def test_a_run_is_like_itself(tmp_path: Path, poses: FloatArray) -> None:
    a = write(tmp_path / "a", poses, [(5, c) for c in range(20)], [(0, 30)])
    assert main(["compare", str(a), str(a), "--json", str(tmp_path / "c.json"), "-q"]) == 0
    data = json.loads((tmp_path / "c.json").read_text())
    assert data["maps"]["shared_of_a"] == data["maps"]["shared_of_b"] == 1.0
    assert data["trajectories"]["aligned"]["translation_m"]["max"] < 1e-12
    assert all(row["change"] == 0 for row in data["summary"].values())


def test_what_is_no_run_is_refused(
    tmp_path: Path, poses: FloatArray, capsys: pytest.CaptureFixture[str]
) -> None:
    a = write(tmp_path / "a", poses, [], [])
    empty = tmp_path / "empty"
    empty.mkdir()
    assert main(["compare", str(a), str(empty)]) == 1
    assert "summary.json: cannot be read" in capsys.readouterr().err
    assert main(["compare", str(a), str(tmp_path / "none")]) == 1
    assert "expected a folder of `mfslam map`" in capsys.readouterr().err
    (a / "summary.json").write_text("{")
    assert main(["compare", str(a), str(a)]) == 1
    assert "expected the JSON that a run leaves" in capsys.readouterr().err
