"""A run's folder: refused early, written whole or not at all, the same bytes twice."""

from __future__ import annotations

import errno
import json
import os
import resource
from pathlib import Path
from typing import IO

import numpy as np
import pytest
from plyfile import PlyData

from mfslam.config import Config
from mfslam.output import ply, prepare_folder, read_graph, read_map, read_tum, write_run
from mfslam.output.summary import loops_in_use
from mfslam.settings import load
from mfslam.types import Edge, Findings, MfslamError, OccupancyGrid, PointCloud, RunResult

FILES = {
    "map.pgm", "map.yaml", "map.png", "trajectory.tum", "trajectory.cov", "keyframes.tum", "graph.g2o", "points.ply",
    "config.yaml", "summary.json", "report.html",
}  # fmt: skip


def written(result: RunResult, folder: Path) -> Path:
    prepare_folder(folder)
    write_run(result, Config(), folder)
    return folder


def test_leaves_all_files_and_nothing_else(result: RunResult, tmp_path: Path) -> None:
    folder = written(result, tmp_path / "deep" / "out")
    assert {p.name for p in folder.iterdir()} == FILES


def test_same_result_same_bytes(result: RunResult, tmp_path: Path) -> None:
    first, second = written(result, tmp_path / "a"), written(result, tmp_path / "b")
    for name in FILES:
        assert (first / name).read_bytes() == (second / name).read_bytes(), name


def test_what_was_written_reads_back(result: RunResult, tmp_path: Path) -> None:
    folder = written(result, tmp_path)
    stamps_ns, poses = read_tum(folder / "trajectory.tum")
    np.testing.assert_array_equal(stamps_ns, result.stamps_ns)  # log order, also where stamps go backwards
    np.testing.assert_allclose(poses, result.world_T_body, atol=1e-9)
    graph = read_graph(folder / "graph.g2o")
    np.testing.assert_array_equal(graph.world_T_pose, result.world_T_body[result.keyframes])
    grid = read_map(folder / "map.yaml")
    np.testing.assert_array_equal(grid.occupancy, result.grid.occupancy)
    np.testing.assert_allclose(grid.origin_m, result.grid.origin_m)
    assert load([folder / "config.yaml"]) == Config()


def test_points_carry_their_own_stamps(result: RunResult, tmp_path: Path) -> None:
    vertices = PlyData.read(str(written(result, tmp_path) / "points.ply"))["vertex"]
    assert len(vertices["x"]) == len(result.points.points_m)
    np.testing.assert_allclose(vertices["x"], result.points.points_m[:, 0], atol=1e-4)
    np.testing.assert_allclose(vertices["y"], result.points.points_m[:, 1], atol=1e-4)
    np.testing.assert_allclose(vertices["time"], result.points.stamps_ns * 1e-9, atol=1e-6, rtol=0)


def test_summary_counts(result: RunResult, tmp_path: Path) -> None:
    summary = json.loads((written(result, tmp_path) / "summary.json").read_text())
    assert summary["counts"] == {"scans": 600, "keyframes": 120, "edges": 260, "points": 5000}
    assert summary["edges"]["loop"]["count"] == 21
    assert summary["edges"]["loop"]["rejected"] == 1
    assert summary["distances"]["travelled_m"] == pytest.approx(152.0, rel=0.01)
    assert summary["loops"]["refused"]["poor_fit"] == 4  # what the engine said is kept
    assert summary["findings"][0]["code"] == "stamp-backwards"


def test_loops_in_use_are_counted_and_held_against_the_solution() -> None:
    """Of four loops over 1 m one is exact, one off by 0.3 m, one by 2 deg, and one, off too, not in use."""
    poses = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    measured = ([1.0, 0.0, 0.0], [1.3, 0.0, 0.0], [1.0, 0.0, np.radians(2.0)], [9.0, 0.0, 0.0])
    weights = (1.0, 1.0, 1.0, 0.0)
    loops = [
        Edge("loop", 0, 1, np.array(m), np.eye(3), weight=w) for m, w in zip(measured, weights, strict=True)
    ]
    told = loops_in_use(poses, [*loops, Edge("scan", 0, 1, np.zeros(3), np.eye(3))])
    assert (told["in_use"], told["in_use_satisfied"], told["refused_by_the_last_solve"]) == (3, 1, 1)
    assert told["in_use_satisfied_percent"] == pytest.approx(100.0 / 3.0)
    assert loops_in_use(poses, [])["in_use_satisfied_percent"] is None


def test_a_run_is_not_overwritten_unasked(result: RunResult, tmp_path: Path) -> None:
    folder = written(result, tmp_path)
    (folder / "notes.txt").write_text("mine")
    with pytest.raises(MfslamError, match=r"already holds a run; give --overwrite"):
        prepare_folder(folder)
    prepare_folder(folder, overwrite=True)
    write_run(result, Config(), folder)
    assert {p.name for p in folder.iterdir()} == FILES | {"notes.txt"}


def test_a_folder_of_others_is_refused(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("x")
    with pytest.raises(MfslamError, match="is not empty"):
        prepare_folder(tmp_path)
    with pytest.raises(MfslamError, match="expected a folder"):
        prepare_folder(tmp_path / "thesis.tex")
    with pytest.raises(MfslamError, match="cannot be written: not a directory"):
        prepare_folder(tmp_path / "thesis.tex" / "out")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_unwritable_folder_is_refused(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    try:
        with pytest.raises(MfslamError, match="cannot be written: permission denied"):
            prepare_folder(tmp_path / "out")
    finally:
        tmp_path.chmod(0o700)


def test_unwritable_device_is_refused() -> None:
    with pytest.raises(MfslamError, match="/proc/out: cannot be written"):
        prepare_folder(Path("/proc/out"))


@pytest.mark.parametrize("old_run", [False, True])
def test_full_disk_leaves_the_folder_as_it_was(
    result: RunResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, old_run: bool
) -> None:
    if old_run:
        written(result, tmp_path)
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    half = RunResult(**{**vars(result), "stamps_ns": result.stamps_ns + 1})

    def full(cloud: PointCloud, file: IO[bytes]) -> None:
        file.write(b"half a file")
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(ply, "write_ply", full)
    with pytest.raises(MfslamError, match=r"points\.ply: cannot be written: no space left on device"):
        write_run(half, Config(), tmp_path)
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == before


def test_a_limit_of_the_system_on_file_size_is_one_line(result: RunResult, tmp_path: Path) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, hard))
    try:
        with pytest.raises(
            MfslamError, match=r"\.(tum|pgm|html|g2o|ply): cannot be written: file too large; free some space"
        ):
            write_run(result, Config(), tmp_path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert not list(tmp_path.iterdir())


def test_interrupt_while_writing_leaves_the_folder_as_it_was(
    result: RunResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(cloud: PointCloud, file: IO[bytes]) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(ply, "write_ply", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_run(result, Config(), tmp_path)
    assert not list(tmp_path.iterdir())


def test_leftovers_of_a_killed_run_are_swept(tmp_path: Path) -> None:
    (tmp_path / ".map.pgm.mfslam-part").write_bytes(b"half")
    prepare_folder(tmp_path)
    assert not list(tmp_path.iterdir())


def test_the_smallest_run_is_written(tmp_path: Path) -> None:
    one = RunResult(
        np.array([5], dtype=np.int64),
        np.zeros((1, 3)),
        np.array([0], dtype=np.int64),
        [],
        OccupancyGrid(np.zeros(2), 0.05, np.full((1, 1), -1, dtype=np.int8)),
        PointCloud(np.zeros((0, 2)), np.zeros(0, dtype=np.int64)),
        Findings(),
        np.zeros((1, 3, 3)),
    )
    folder = written(one, tmp_path)
    assert read_graph(folder / "graph.g2o").fixed == {0}
    assert "nothing to show" in (folder / "report.html").read_text()


def test_a_trajectory_that_is_not_finite_never_reaches_the_disk(result: RunResult, tmp_path: Path) -> None:
    result.world_T_body[3, 1] = np.nan
    with pytest.raises(ValueError, match="not finite"):
        write_run(result, Config(), tmp_path)
    assert not list(tmp_path.iterdir())


def test_rejected_edges_stay_out_of_the_graph(result: RunResult, tmp_path: Path) -> None:
    folder = written(result, tmp_path)
    rejected = [edge for edge in result.edges if edge.weight == 0]
    text = (folder / "graph.g2o").read_text()
    assert text.count("# rejected: EDGE_SE2") == len(rejected) == 1
    assert len(read_graph(folder / "graph.g2o").i) == len(result.edges) - 1


def test_weights_scale_the_information(result: RunResult, tmp_path: Path) -> None:
    edge = result.edges[1]
    result.edges[1] = Edge(edge.kind, edge.i, edge.j, edge.i_T_j, edge.information, weight=0.25)
    graph = read_graph(written(result, tmp_path) / "graph.g2o")
    np.testing.assert_array_equal(graph.information[1], 0.25 * edge.information)
