"""evaluate, optimize and compare on input that cannot be: one clear line, no trace, exit 1."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest

from mfslam.cli import main
from mfslam.output import read_graph

TUM = "".join(f"{100 + n} {n} 0 0 0 0 0 1\n" for n in range(5))
RELATIONS = "100 101 1 0 0 0 0 0\n"
GRAPH = """VERTEX_SE2 0 0 0 0
VERTEX_SE2 1 1 0 0
EDGE_SE2 0 1 1 0 0 10 0 0 10 0 10
"""


@pytest.fixture
def good(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    Path("good.tum").write_text(TUM)
    Path("good.relations").write_text(RELATIONS)
    Path("good.g2o").write_text(GRAPH)
    return tmp_path


def told(capsys: pytest.CaptureFixture[str], *args: str) -> str:
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # numpy's about overflow and casts
        assert main(list(args)) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    return err


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("bad.tum", "1e30 0 0 0 0 0 0 1\n", "bad.tum:1: expected 'stamp x y z qx qy qz qw'"),
        ("bad.tum", "-1e12 0 0 0 0 0 0 1\n", "bad.tum:1: expected 'stamp x y z qx qy qz qw'"),
        ("bad.tum", "100 1e300 0 0 0 0 0 1\n", "bad.tum:1: expected finite numbers up to 1e+09"),
        ("bad.clf", "FLASER 1 1 1e300 0 0 0 0 0 5 h 5\n", "bad.clf:1: expected a finite pose"),
        ("bad.clf.gz", "no gzip", "bad.clf.gz: cannot be read: not a gzipped file"),
    ],
)
def test_results_out_of_any_range(
    good: Path, capsys: pytest.CaptureFixture[str], name: str, text: str, message: str
) -> None:
    Path(name).write_text(text)
    assert message in told(capsys, "evaluate", name, "--relations", "good.relations")
    assert message in told(capsys, "evaluate", "good.tum", "--truth", name)


@pytest.mark.parametrize(
    "line", ["1e30 1e30 1 0 0 0 0 0", "100 101 1e308 1e308 0 0 0 0", "100 101 nan 0 0 0 0 0"]
)
def test_relations_out_of_any_range(good: Path, capsys: pytest.CaptureFixture[str], line: str) -> None:
    Path("bad.relations").write_text(line + "\n")
    message = told(capsys, "evaluate", "good.tum", "--relations", "bad.relations")
    assert "bad.relations:1: expected finite numbers" in message


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("0 0 0 0\n0 1 1 1\n", "vertex 0 is given twice"),
        ("1e30 0 0 0\n", "truth.txt:1: expected"),
        ("0 1e308 0\n1 0 0\n", "truth.txt:1: expected"),
    ],
)
def test_true_vertices_that_cannot_be(
    good: Path, capsys: pytest.CaptureFixture[str], text: str, message: str
) -> None:
    Path("truth.txt").write_text(text)
    assert message in told(capsys, "evaluate", "good.g2o", "--graph-truth", "truth.txt")


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (
            ["--relations", "good.relations", "--tolerance", "nan"],
            "--tolerance: expected 0 to 1e+06 s, got nan",
        ),
        (["--relations", "good.relations", "--tolerance", "-1"], "--tolerance: expected"),
        (["--truth", "good.tum", "--max-difference", "1e300"], "--max-difference: expected"),
        (["--truth", "good.tum", "-o", "a", "--json", "./a"], "a: two outputs cannot go to one file"),
        (["--truth", "good.tum", "-o", "none/a.html"], "none/a.html: cannot be written"),
        (["--truth", "."], "holds no trajectory.tum"),
    ],
)
def test_options_of_evaluate(
    good: Path, capsys: pytest.CaptureFixture[str], args: list[str], message: str
) -> None:
    assert message in told(capsys, "evaluate", "good.tum", *args)


def test_a_robot_that_stood_still_has_a_page(good: Path) -> None:
    Path("still.tum").write_text("".join(f"{100 + n} 0 0 0 0 0 0 1\n" for n in range(5)))
    assert main(["evaluate", "still.tum", "--truth", "still.tum", "-o", "page.html", "-q"]) == 0
    assert "<svg" in Path("page.html").read_text()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (GRAPH.replace("1 1 0 0\n", "1 1e308 0 0\n"), "bad.g2o:2: expected finite numbers after VERTEX_SE2, poses up to 1e+09"),
        (GRAPH.replace("10 0 0 10", "1e300 0 0 10"), "bad.g2o:3: expected finite numbers after EDGE_SE2"),
        (GRAPH[:-8], "bad.g2o:3: expected 'EDGE_SE2 i j x y theta"),
        ("VERTEX_SE2 99999999999999999999 0 0 0\n", "bad.g2o:1: expected an id of at most 63 bits"),
        ("1 2 3 4\n", "bad.g2o:1: 1: expected one of FIX"),
    ],
)  # fmt: skip
def test_graphs_out_of_any_range(
    good: Path, capsys: pytest.CaptureFixture[str], text: str, message: str
) -> None:
    Path("bad.g2o").write_text(text)
    assert message in told(capsys, "optimize", "bad.g2o")


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (
            ["--robust", "cauchy", "--kernel-sigmas", "-1"],
            "--kernel-sigmas: expected 1e-6 to 1e6 sigmas, got -1",
        ),
        (["--robust", "cauchy", "--kernel-sigmas", "nan"], "--kernel-sigmas: expected"),
        (["--kernel-sigmas", "3"], "--kernel-sigmas: only kernels have a scale"),
        (["-o", "x.g2o", "--json", "x.g2o"], "two outputs cannot go to one file"),
        (["-o", "."], "expected a file to write, this is a folder"),
    ],
)
def test_options_of_optimize(
    good: Path, capsys: pytest.CaptureFixture[str], args: list[str], message: str
) -> None:
    assert message in told(capsys, "optimize", "good.g2o", *args)


@pytest.mark.parametrize("start", ["auto", "file"])
def test_a_far_first_guess_does_not_hide_what_the_edges_say(good: Path, start: str) -> None:
    Path("far.g2o").write_text(GRAPH.replace("VERTEX_SE2 1 1", "VERTEX_SE2 1 1e8"))
    assert main(["optimize", "far.g2o", "-q", "--start", start, "-o", "out.g2o"]) == 0
    np.testing.assert_allclose(read_graph(Path("out.g2o")).world_T_pose[1], [1.0, 0.0, 0.0], atol=1e-6)
