"""A finished run as the viewer reads it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from runs import finished_run

from mfslam.output import read_map, read_tum
from mfslam.types import MfslamError, OccupancyGrid
from mfslam.viewer.first_sight import LATEST, first_sights
from mfslam.viewer.run import show_run


def test_cells_are_seen_when_a_beam_first_crosses_them() -> None:
    """A robot that drives along a corridor of 100 cells, and sees 10 cells ahead in each of its 91 scans."""
    grid = OccupancyGrid(np.zeros(2), 0.1, np.zeros((3, 100), dtype=np.int8))
    scans = np.arange(91)
    poses = np.column_stack([0.1 * scans + 0.05, np.full(91, 0.15), np.zeros(91)])
    seen = first_sights(grid, poses, poses[:, :2] + [0.9, 0.0], scans)
    assert seen is not None
    first = (seen[1].astype(float) - 1.0) / ((LATEST - 1) / 90)
    np.testing.assert_allclose(first[11:], np.arange(2, 91), atol=1.0)
    assert (first[:10] < 0.1).all()
    np.testing.assert_array_equal(seen[0], seen[1])  # no beam crossed row 0: as its neighbour


def test_a_run_is_served_as_it_lies_there(tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = finished_run(tmp_path_factory)
    show = show_run(folder)
    stamps_ns, poses = read_tum(folder / "trajectory.tum")
    table = np.frombuffer(show.run["trajectory.bin"], dtype="<f4").reshape(-1, 8)
    np.testing.assert_allclose(table[:, 1:4], poses, atol=1e-4)
    np.testing.assert_allclose(table[:, 0], (stamps_ns - stamps_ns[0]) * 1e-9, atol=1e-3)
    keyframes = np.frombuffer(show.run["keyframes.bin"], dtype="<u4")
    np.testing.assert_array_equal(stamps_ns[keyframes], read_tum(folder / "keyframes.tum")[0])
    snapshot = show.hub.snapshot
    np.testing.assert_allclose(snapshot.path_mm * 1e-3, poses[keyframes, :2], atol=2e-3)
    occupied = sum(int((tile.cells == 2).sum()) for tile in snapshot.map.tiles.values())
    assert occupied == int((read_map(folder / "map.yaml").occupancy == 100).sum())
    assert snapshot.status["counts"]["scans"] == len(poses)


def test_the_hits_of_a_scan_lie_around_it(tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = finished_run(tmp_path_factory)
    scans = show_run(folder).run["scans.bin"]
    _, poses = read_tum(folder / "trajectory.tum")
    data = scans(first=10, count=2)
    n, a, b = np.frombuffer(data, dtype="<u4", count=3)
    points = np.frombuffer(data, dtype="<f4", offset=12).reshape(-1, 2)
    assert n == 2 and len(points) == a + b and a > 100
    assert np.hypot(*(points[:a] - poses[10, :2]).T).max() < 30.0
    with pytest.raises(ValueError, match="no scans from"):
        scans(first=len(poses), count=1)


@pytest.mark.parametrize(
    ("name", "text", "told"),
    [
        ("trajectory.tum", None, "holds no trajectory.tum"),
        ("map.yaml", None, "map.yaml: cannot be read"),
        ("points.ply", b"ply\nnonsense", "points.ply: expected the points of a run"),
        ("graph.g2o", b"VERTEX_SE2 0 a b c\n", "graph.g2o:1:"),
        ("summary.json", b"{", "summary.json: cannot be read"),
    ],
)
def test_a_folder_that_is_broken_is_told_in_one_line(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory, name: str, text: bytes | None, told: str
) -> None:
    for file in finished_run(tmp_path_factory).iterdir():
        if file.name != name:
            (tmp_path / file.name).symlink_to(file)
        elif text is not None:
            (tmp_path / name).write_bytes(text)
    with pytest.raises(MfslamError, match=told) as error:
        show_run(tmp_path)
    assert "\n" not in str(error.value)
