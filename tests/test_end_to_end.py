"""Whole runs: the same bytes twice, the same trajectory from every format, and the right one."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from short_logs import drive, head_of_log

from drivers.logs import default_presets, open_log
from drivers.writers.log import write_log
from mfslam import se2
from mfslam.cli import main
from mfslam.metrics import read_relations, relations_error
from mfslam.output import read_map, read_tum
from mfslam.settings import load, preset_path
from mfslam.types import FloatArray, IntArray, Scan

REPEATED = ("map.pgm", "map.png", "map.yaml", "trajectory.tum", "keyframes.tum", "graph.g2o", "points.ply")


def mapped(log: Path, out: Path, *settings: str) -> dict[str, Any]:
    """Run `mfslam map`; its summary."""
    extra = [word for setting in settings for word in ("--set", setting)]
    assert main(["map", str(log), "-o", str(out), "-q", *extra]) == 0
    summary: dict[str, Any] = json.loads((out / "summary.json").read_text())
    return summary


def largest_difference(a: Path, b: Path) -> tuple[float, float]:
    """Of two trajectories of the same scans, whose stamps may differ by a constant: m, rad."""
    (a_ns, a_poses), (b_ns, b_poses) = read_tum(a / "trajectory.tum"), read_tum(b / "trajectory.tum")
    assert np.ptp(a_ns - b_ns) < 1000
    error = se2.between(a_poses, b_poses)
    return float(np.hypot(error[:, 0], error[:, 1]).max()), float(np.abs(error[:, 2]).max())


def same_bytes(log: Path, folder: Path) -> None:
    mapped(log, folder / "first")
    mapped(log, folder / "second")
    for name in REPEATED:
        assert (folder / "first" / name).read_bytes() == (folder / "second" / name).read_bytes(), name


def test_a_simulated_log_gives_the_same_bytes_twice(tmp_path: Path) -> None:
    log = tmp_path / "drive.mcap"
    write_log(drive().messages[:2000], log)
    same_bytes(log, tmp_path)


def test_a_recorded_log_gives_the_same_bytes_twice(shared_data: Path, tmp_path: Path) -> None:
    same_bytes(
        head_of_log(shared_data / "freiburg" / "intel.clf.gz", tmp_path / "intel.clf", b"FLASER", 800),
        tmp_path,
    )


def test_the_demo_is_within_a_cell_of_the_truth(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "demo"
    assert main(["demo", "-o", str(out)]) == 0
    summary = json.loads((out / "summary.json").read_text())
    assert summary["truth"]["ate_rms_m"] < 0.01
    assert summary["truth"]["ate_rms_deg"] < 0.2
    # its wheels: radii 3.12 and 2.84 % smaller than told, 0.35 m apart and 2 % more
    assert summary["wheels"]["scale_error_percent"] == pytest.approx(-2.98, abs=0.3)
    assert summary["wheels"]["drift_deg_per_m"] == pytest.approx(
        math.degrees(0.0028 / 0.357), abs=0.15
    )  # slip hides the rest
    assert summary["wheels"]["turn_error_percent"] == pytest.approx(-4.88, abs=0.5)
    said = capsys.readouterr().out
    assert str(out / "map.png") in said and str(out / "demo.mcap") in said
    mapped(out / "demo.mcap", tmp_path / "by_map")
    assert (tmp_path / "by_map" / "map.pgm").read_bytes() == (out / "map.pgm").read_bytes()


def test_the_demo_replaces_no_other_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "summary.json").write_text("of something else")
    assert main(["demo", "-o", str(tmp_path), "-q"]) == 1
    assert "already holds a run" in capsys.readouterr().err


# --- recorded logs -----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def building(shared_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The first 1,500 scans of a CARMEN log."""
    target = tmp_path_factory.mktemp("building") / "building.clf"
    return head_of_log(shared_data / "freiburg" / "fr079.clf.gz", target, b"FLASER", 1500)


@pytest.fixture(scope="module")
def building_run(building: Path) -> Path:
    mapped(building, building.parent / "carmen")
    return building.parent / "carmen"


def assert_right(shared_data: Path, stamps_ns: IntArray, poses: FloatArray) -> None:
    relations = read_relations(shared_data / "freiburg" / "fr079.relations")
    error = relations_error(stamps_ns, poses, relations)
    assert error.matched > 300
    assert error.translation_m.mean < 0.04 and error.rotation_deg.mean < 0.5


def test_a_recorded_building_fits_its_ground_truth(shared_data: Path, building_run: Path) -> None:
    stamps_ns, poses = read_tum(building_run / "trajectory.tum")
    assert_right(shared_data, stamps_ns, poses)
    grid = read_map(building_run / "map.yaml")
    assert {int(v) for v in np.unique(grid.occupancy)} == {-1, 0, 100}


def test_every_bag_format_gives_the_same_trajectory(
    shared_data: Path, building: Path, building_run: Path, tmp_path: Path
) -> None:
    settings = load([preset_path(name) for name in default_presets(building)])
    with open_log(building, settings) as log:
        messages = list(log)
    runs = []
    for name in ("log.bag", "log.db3", "log.mcap"):
        write_log(messages, tmp_path / name)
        summary = mapped(tmp_path / name, tmp_path / f"{name}-run")
        assert summary["counts"]["scans"] == sum(isinstance(message, Scan) for message in messages)
        runs.append(tmp_path / f"{name}-run")
    for run in runs[1:]:
        metres, radians = largest_difference(runs[0], run)
        assert metres < 0.001 and radians < 0.001
    # a bag is stamped at the first ray and does not name its laser: as right as the CARMEN log, not the same
    stamps_ns, _ = read_tum(building_run / "trajectory.tum")
    _, poses = read_tum(runs[0] / "trajectory.tum")
    assert_right(shared_data, stamps_ns, poses)


def test_each_beam_from_its_own_pose_gives_a_crisper_map(shared_data: Path, tmp_path: Path) -> None:
    """On a real URG-04LX at up to 3 m/s: sharper than without deskewing, and than in the wrong beam order."""
    log = shared_data / "urg04lx" / "exp3.dat.gz"
    settings = {"on": [], "off": ["deskew.mode=none"], "reversed": ["sensor.reversed_beams=true"]}
    crisp = {name: mapped(log, tmp_path / name, *extra)["crispness"] for name, extra in settings.items()}
    assert crisp["on"]["cells"] < 0.99 * crisp["off"]["cells"]
    assert crisp["on"]["entropy_nats"] < crisp["off"]["entropy_nats"] - 0.005
    assert crisp["on"]["cells"] < 0.99 * crisp["reversed"]["cells"]
