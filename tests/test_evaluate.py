"""Results held against truths and against each other, as a user does it."""

from __future__ import annotations

import bz2
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mfslam import se2
from mfslam.cli import main
from mfslam.metrics import drift, nees, paired_bootstrap
from mfslam.output.results import read_carmen, read_graph_truth, read_result
from mfslam.output.tum import trajectory_text
from mfslam.types import FloatArray, MfslamError

NS = 1_000_000_000


def run(*args: str | Path) -> int:
    return main([str(arg) for arg in args])


def walk(count: int = 300, seed: int = 1) -> FloatArray:
    rng = np.random.default_rng(seed)
    poses = np.zeros((count, 3))
    for n in range(1, count):
        poses[n] = se2.compose(poses[n - 1], np.array([0.2, 0.0, 0.0]) + rng.normal(0, [0.02, 0, 0.05]))
    return poses


def noisy(poses: FloatArray, sigma: float, seed: int = 2) -> FloatArray:
    rng = np.random.default_rng(seed)
    return se2.compose(poses, rng.normal(0.0, [sigma, sigma, sigma / 2], poses.shape))


@pytest.fixture
def files(tmp_path: Path) -> Path:
    stamps = np.arange(300, dtype=np.int64) * NS // 10
    truth = walk()
    for name, poses in (("truth", truth), ("good", noisy(truth, 0.02)), ("bad", noisy(truth, 0.06, 3))):
        (tmp_path / f"{name}.tum").write_text(trajectory_text(stamps, poses))
    pairs = se2.between(truth[:-20], truth[20:])
    (tmp_path / "r.relations").write_text(
        "".join(f"{n / 10} {n / 10 + 2} {p[0]} {p[1]} 0 0 0 {p[2]}\n" for n, p in enumerate(pairs))
    )
    return tmp_path


def evaluated(folder: Path, *args: str | Path) -> dict[str, Any]:
    assert run("evaluate", *args, "--json", folder / "found.json", "-q") == 0
    return dict(json.loads((folder / "found.json").read_text()))


def test_agrees_with_evo_on_the_same_files(files: Path) -> None:
    pytest.importorskip("evo")
    from evo.core import metrics, sync
    from evo.tools import file_interface

    reference = file_interface.read_tum_trajectory_file(str(files / "truth.tum"))
    ours = evaluated(files, files / "good.tum", "--truth", files / "truth.tum", "--rpe-step", "5")["results"][
        0
    ]
    for alignment in ("none", "origin", "best"):
        estimate = file_interface.read_tum_trajectory_file(str(files / "good.tum"))
        a, b = sync.associate_trajectories(reference, estimate)
        if alignment == "origin":
            b.align_origin(a)
        elif alignment == "best":
            b.align(a, correct_scale=False)
        for part, relation in (("translation_m", "translation_part"), ("rotation_deg", "rotation_angle_deg")):
            ape = metrics.APE(metrics.PoseRelation[relation])
            ape.process_data((a, b))
            theirs = ape.get_all_statistics()
            for key in ("mean", "median", "std", "max", "rmse"):
                assert ours["ate"][alignment][part][key] == pytest.approx(theirs[key], abs=1e-9), (
                    alignment,
                    part,
                    key,
                )
            step = metrics.RPE(metrics.PoseRelation[relation], 5, metrics.Unit.frames, all_pairs=True)
            step.process_data((a, b))
            theirs = step.get_all_statistics()
            for key in ("mean", "median", "std", "max", "rmse"):
                assert ours["rpe"][part][key] == pytest.approx(theirs[key], abs=1e-9), (alignment, part, key)


def test_results_side_by_side_with_a_test_of_their_difference(
    files: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page, single = files / "page.html", files / "list.csv"
    status = run("evaluate", files / "good.tum", files / "bad.tum", "--relations", files / "r.relations", "-o", page, "--list", single)  # fmt: skip
    told = capsys.readouterr().out
    assert status == 0
    assert "good.tum  280 of 280" in told
    assert "good.tum is better" in told
    text = page.read_text()
    assert "http" not in text.replace("http://www.w3.org", "")  # opens offline
    assert text.count("<svg") == 5
    assert len(single.read_text().splitlines()) == 1 + 2 * 280


def test_long_names_lose_their_middle_in_tables_and_keep_it_in_json(
    files: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    long = "_".join(["resolution"] * 8) + ".tum"
    (files / long).write_text((files / "bad.tum").read_text())
    page, found = files / "page.html", files / "found.json"
    args = ["--relations", files / "r.relations", "-o", page, "--json", found]
    assert run("evaluate", files / "good.tum", files / long, *args) == 0
    told = capsys.readouterr().out
    assert long not in told + page.read_text()
    assert "resolution_resolution_re...esolution.tum  280 of 280" in told
    assert max(map(len, told.splitlines())) < 160
    assert json.loads(found.read_text())["results"][1]["name"] == long


def test_ten_results_have_ten_looks_and_a_short_title(files: Path) -> None:
    others = [files / f"result_{n}.tum" for n in range(9)]
    for n, path in enumerate(others):
        path.write_text((files / ("good.tum" if n % 2 else "bad.tum")).read_text())
    page = files / "page.html"
    args = ["--relations", files / "r.relations", "-o", page, "-q"]
    assert run("evaluate", files / "good.tum", *others, *args) == 0
    text = page.read_text()
    assert "<h1>10 results</h1>" in text
    legend = text.partition('<div class="legend">')[2].partition("</div>")[0]
    assert len(set(re.findall(r'<i class="([^"]+)">', legend))) == 10


def test_unmatched_entries_are_counted_and_none_matched_tells_both_ranges(
    files: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = (files / "good.tum").read_text().splitlines()
    (files / "half.tum").write_text("\n".join(lines[:151]) + "\n")
    half = evaluated(files, files / "half.tum", "--relations", files / "r.relations")["results"][0][
        "relations"
    ]
    assert (half["matched"], half["unmatched"]) == (130, 150)
    late = (files / "good.tum").read_text().replace("\n", "\n9")[:-1]
    (files / "late.tum").write_text(late)
    assert run("evaluate", files / "late.tum", "--relations", files / "r.relations") == 1
    assert "relations run from 0.000000 to 29.900000 s, poses from 90.000000" in capsys.readouterr().err


def test_a_corrected_carmen_log_is_a_result(files: Path) -> None:
    truth = walk()
    lines = ["# robot"]
    for n, (x, y, t) in enumerate(truth.tolist()):
        lines.append(f"FLASER 2 1.0 1.0 {x!r} {y!r} {t!r} 0 0 0 {n / 10} host {n / 10}")
    path = files / "log.clf.bz2"
    path.write_bytes(bz2.compress("\n".join(lines).encode()))
    error = evaluated(files, path, "--truth", files / "truth.tum")["results"][0]["ate"]["none"]
    assert error["translation_m"]["max"] < 1e-8
    robot = "ROBOTLASER1 0 -1.57 3.14 0.01 80 0.01 0 2 1.0 1.0 1 0.5 7 8 0.1 7 8 0.1 0 0 0 0 0 12.5 host 12.5"
    (files / "robot.log").write_text(robot + "\n")
    stamps_ns, poses = read_carmen(files / "robot.log")
    assert stamps_ns.tolist() == [12_500_000_000]
    assert poses.tolist() == [[7.0, 8.0, 0.1]]


def test_a_graph_is_held_against_true_poses_and_true_edges(shared_data: Path, tmp_path: Path) -> None:
    home = shared_data / "pose_graphs" / "manhattan"
    graph = home / "manhattanOlson3500.g2o"
    solved = tmp_path / "solved.g2o"
    assert run("optimize", graph, "-o", solved, "-q", "--no-certificate") == 0
    nodes = evaluated(tmp_path, solved, "--graph-truth", home / "manhattanOlson3500_nodes_groundTruth.dat")
    assert nodes["results"][0]["ate"]["best"]["translation_m"]["rmse"] == pytest.approx(0.794, abs=1e-3)
    edges = evaluated(tmp_path, solved, "--graph-truth", home / "manhattanOlson3500_edges_groundTruth.dat")
    assert edges["results"][0]["relations"]["matched"] == 5598
    assert edges["results"][0]["relations"]["translation_m"]["median"] < 0.03


def test_drift_grows_with_the_length_of_the_stretch() -> None:
    truth = np.column_stack([0.5 * np.arange(400.0), np.zeros(400), np.zeros(400)])
    stretched = truth * [1.01, 1.0, 1.0]
    rows = drift(truth, stretched)
    assert [row.length_m for row in rows] == [1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0]
    for row in rows:
        assert row.translation_m == pytest.approx(0.01 * row.length_m)


def test_nees_of_honest_covariances_is_one_and_of_small_ones_is_more() -> None:
    rng = np.random.default_rng(4)
    truth = np.column_stack([np.arange(5000.0), np.zeros(5000), rng.uniform(-3, 3, 5000)])
    truth[0] = 0.0
    covariance = np.array([[0.04, 0.01, 0.0], [0.01, 0.09, 0.002], [0.0, 0.002, 0.01]])
    estimate = truth + np.vstack([np.zeros(3), rng.multivariate_normal(np.zeros(3), covariance, 4999)])
    moved = se2.compose(np.array([3.0, 1.0, 0.0]), estimate)
    stated = np.tile(covariance, (5000, 1, 1))
    honest = nees(truth, moved, stated)
    assert honest.mean == pytest.approx(1.0, abs=0.05)
    assert honest.within == pytest.approx(0.95, abs=0.01)
    assert nees(truth, moved, stated / 4).mean == pytest.approx(4.0, abs=0.2)
    with pytest.raises(MfslamError, match="no covariance is positive definite"):
        nees(truth, moved, 0 * stated)


def test_stated_covariances_are_judged_when_a_run_has_them(files: Path) -> None:
    folder = files / "run"
    folder.mkdir()
    text = (files / "good.tum").read_text()
    (folder / "trajectory.tum").write_text(text)
    stamps = [line.split()[0] for line in text.splitlines()[1:]]
    (folder / "trajectory.cov").write_text("".join(f"{s} 4e-4 0 0 4e-4 0 1e-4\n" for s in stamps))
    found = evaluated(files, folder, "--truth", files / "truth.tum")["results"][0]["nees"]
    assert found["poses"] == 299
    (folder / "trajectory.cov").write_text("1 4e-4 0 0 4e-4 0 1e-4\n")
    with pytest.raises(MfslamError, match="its stamps are not those"):
        read_result(folder)


def test_the_bootstrap_knows_noise_from_difference() -> None:
    rng = np.random.default_rng(5)
    a = rng.exponential(1.0, 500)
    assert not paired_bootstrap(a, a + rng.normal(0.0, 0.2, 500)).significant
    better = paired_bootstrap(a, a - 0.1 + rng.normal(0.0, 0.2, 500))
    assert better.significant
    assert better.low < -0.1 < better.high
    assert better.p < 0.01
    # errors that hang together count for fewer: one long wave is no evidence
    wave = np.sin(np.arange(500) / 500 * 2 * np.pi)
    single = paired_bootstrap(a, a + rng.permutation(wave))
    blocks = paired_bootstrap(a, a + wave)
    assert blocks.high - blocks.low > 2 * (single.high - single.low)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("t.tum", "1 2 3\n", r"t.tum:1: expected 'stamp x y z qx qy qz qw'"),
        ("t.g2o", "VERTEX_SE2 0 0 0\n", r"t.g2o:1: expected 'VERTEX_SE2 id x y theta'"),
        ("t.clf", "FLASER 180 1 2 3\n", r"t.clf:1: expected a whole FLASER line"),
        ("t.log", "ODOM 1 2 3\n", "holds no FLASER"),
        ("t.clf.gz", "no gzip", "cannot be read"),
    ],
)
def test_results_that_are_none_get_one_line(
    files: Path, capsys: pytest.CaptureFixture[str], name: str, text: str, message: str
) -> None:
    (files / name).write_text(text)
    assert run("evaluate", files / name, "--truth", files / "truth.tum") == 1
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert message.removeprefix("r") in told


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("t.txt", "0 0 0\n1 1\n", r"t.txt:2: expected 3 finite numbers as before"),
        ("t.txt", "0 zero 0\n", r"t.txt:1: expected 'x y theta'"),
        ("t.txt", "0.5 0 0 0\n", r"expected whole numbers as ids, got 0.5"),
        ("t.txt", "# none\n", r"holds no pose"),
    ],
)
def test_graph_truths_that_are_none_get_one_line(tmp_path: Path, name: str, text: str, message: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(MfslamError, match=message):
        read_graph_truth(tmp_path / name)


def test_what_does_not_fit_together_is_told(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    graph = files / "g.g2o"
    graph.write_text("VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nEDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n")
    (files / "nodes.txt").write_text("7 0 0 0\n8 1 0 0\n")
    for args, message in (
        ([graph, "--truth", files / "truth.tum"], "a graph has no stamps; hold it against --graph-truth"),
        ([files / "good.tum", "--truth", graph], "a graph has no stamps; give it as --graph-truth"),
        ([files / "good.tum", "--graph-truth", files / "nodes.txt"], "expected a graph (g2o)"),
        ([graph, "--graph-truth", files / "nodes.txt"], "the truth has 7 to 8, the graph 0 to 1"),
        ([files / "good.tum", "--truth", files / "truth.tum", "--rpe-step", "0"], "at least 1 pose, got 0"),
        ([files, "--truth", files / "truth.tum"], "holds no trajectory.tum"),
    ):
        assert run("evaluate", *args) == 1
        assert message in capsys.readouterr().err
