"""scripts/benchmark.py: what it finds, measures and writes, with a stand-in for the command it times."""

from __future__ import annotations

import importlib
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from mfslam.types import MfslamError

SCRIPTS = Path(__file__).resolve().parent.parent / "scripts"

STAND_IN = """#!{python}
import json, sys
from pathlib import Path
log, out = Path(sys.argv[2]), Path(sys.argv[4])
if "broken" in log.name:
    sys.exit("mfslam: " + log.name + ": holds no scan")
out.mkdir()
cells = 900 if "deskew.mode=none" not in sys.argv else 1000
summary = {{"counts": {{"scans": 3}}, "distances": {{"travelled_m": 2.0, "log_duration_s": 120.0}},
           "crispness": {{"cells": cells, "entropy_nats": 5.0}},
           "reading_cost_by_quarter": [{{"travelled_m": 50.0, "cpu_s": s}} for s in (0.1, 0.2, 0.3, 0.4)],
           "loops": {{"in_use": 40, "in_use_satisfied": 40, "in_use_satisfied_percent": 100.0,
                     "refused_by_the_last_solve": 2, "taken_out_while_mapping": 1}}}}
(out / "summary.json").write_text(json.dumps(summary))
(out / "trajectory.tum").write_text("1 0 0 0 0 0 0 1\\n2 1 0 0 0 0 0 1\\n3 2.5 0 0 0 0 0 1\\n")
"""


@pytest.fixture
def benchmark(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(SCRIPTS)
    module = importlib.import_module("benchmark")
    command = tmp_path / "bin" / "mfslam"
    command.parent.mkdir()
    command.write_text(STAND_IN.format(python=sys.executable))
    command.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(command.with_name("python")))
    return module


@pytest.fixture
def data(tmp_path: Path) -> Path:
    folder = tmp_path / "data"
    folder.mkdir()
    (folder / "broken.bag").write_bytes(b"")
    (folder / "office.clf.gz").write_bytes(b"xx")
    (folder / "office.relations").write_text("1 2 1 0 0 0 0 0\n2 3 1 0 0 0 0 0\n7 8 1 0 0 0 0 0\n")
    (folder / "yard.dat").write_bytes(b"xxx")
    (folder / "notes.txt").write_text("no log")
    return folder


def test_every_log_is_run_and_scored(
    benchmark: ModuleType,
    data: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    page, figures = tmp_path / "docs" / "benchmarks.md", tmp_path / "b.json"
    arguments = ["benchmark", "--data", str(data), "--json", str(figures), "--markdown", str(page)]
    monkeypatch.setattr(sys, "argv", arguments)
    assert benchmark.main() == 0
    told = capsys.readouterr().out
    assert "2 of 3" in told and "0.2500" in told  # errors of 0 and 0.5 m, one relation unmatched
    assert "holds no scan" in told
    runs = {(run["log"], run["variant"]): run for run in json.loads(figures.read_text())["runs"]}
    assert set(runs) == {
        ("broken", "deskew on"), ("office", "deskew on"),
        ("yard", "deskew on"), ("yard", "deskew off"), ("yard", "beams reversed"),
    }  # fmt: skip
    office = runs["office", "deskew on"]
    assert office["cpu_s"] > 0 and office["peak_mb"] > 1
    assert office["real_time_factor"] == pytest.approx(120.0 / office["cpu_s"])
    assert "| office | 50 | 2.0 | 4.0 | 6.0 | 8.0 |" in page.read_text()
    assert "| yard | deskew on | 900 | -10.0 % | 5.000 |" in page.read_text()


def test_the_page_around_the_tables_is_kept(benchmark: ModuleType, tmp_path: Path) -> None:
    from benchmarking.page import LOGS, markers

    BEGIN, END = markers(LOGS)

    page = tmp_path / "b.md"
    page.write_text(f"# Mine\n{BEGIN}\nold\n{END}\nAfter.\n")
    benchmark.write_markdown(page, [], "scripts/benchmark.py")
    text = page.read_text()
    assert text.startswith("# Mine\n") and text.endswith("\nAfter.\n") and "old" not in text
    page.write_text("no markers")
    with pytest.raises(MfslamError, match="expected the markers"):
        benchmark.write_markdown(page, [], "x")


def test_a_folder_without_logs_is_named(benchmark: ModuleType, tmp_path: Path) -> None:
    with pytest.raises(MfslamError, match="no such folder"):
        benchmark.find_logs(tmp_path / "none", [])
    with pytest.raises(MfslamError, match="no log here"):
        benchmark.find_logs(tmp_path, [])


def test_check_fails_when_accuracy_fell_by_more_than_a_tenth(
    benchmark: ModuleType,
    data: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    page = tmp_path / "b.md"
    monkeypatch.setattr(benchmark, "PAGE", page)
    monkeypatch.setattr(
        sys, "argv", ["benchmark.py", "--data", str(data), "--only", "office", "--markdown", str(page)]
    )
    assert benchmark.main() == 0
    check = ["benchmark.py", "--data", str(data), "--check"]
    monkeypatch.setattr(sys, "argv", check)
    assert benchmark.main() == 0
    assert "accuracy: as stored" in capsys.readouterr().out
    page.write_text(page.read_text().replace("| 0.2500 |", "| 0.2200 |", 1))
    assert benchmark.main() == 1
    assert "office: mean m is 0.2500, stored 0.2200" in capsys.readouterr().err
    page.write_text("no table")
    assert benchmark.main() == 1
    assert "holds no table of log, relations" in capsys.readouterr().err


@pytest.mark.parametrize("figure", ["mean m", "median m", "mean deg", "median deg"])
@pytest.mark.parametrize(
    ("worse", "is_told"), [(1.05, False), (1.09, False), (1.11, True), (2.0, True), (0.5, False)]
)
def test_a_tenth_is_the_line_for_every_figure_that_is_checked(
    benchmark: ModuleType, tmp_path: Path, figure: str, worse: float, is_told: bool
) -> None:
    runs, check = (importlib.import_module(f"benchmarking.{name}") for name in ("runs", "check"))

    def outcome(factor: float) -> Any:
        part, key = ("translation_m" if figure.endswith("m") else "rotation_deg"), figure.split()[0]
        relations: dict[str, Any] = {
            "matched": 90, "unmatched": 10,
            "translation_m": {"mean": 0.1, "median": 0.08, "p99": 0.4},
            "rotation_deg": {"mean": 1.0, "median": 0.8, "p99": 4.0},
        }  # fmt: skip
        relations[part][key] *= factor
        return runs.Outcome("office", "deskew on", True, relations=relations)

    page = tmp_path / "b.md"
    tables = importlib.import_module("benchmarking.tables")
    benchmark.write_markdown(page, [("Relations error", tables.accuracy_table([outcome(1.0)]))], "command")
    complaints = check.complaints([outcome(worse)], page)
    assert len(complaints) == is_told
    assert all(f"office: {figure} is" in line for line in complaints)


def test_tables_of_graphs_reach_the_page_row_by_row(
    benchmark: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    graphs = importlib.import_module("benchmark_graphs")
    page = tmp_path / "b.md"
    page.write_text("\n".join(f"<!-- graphs-{name}: {end} -->" for name in "ab" for end in ("begin", "end")))
    (tmp_path / "pose_graphs").mkdir()

    def ends_early(folder: Path) -> Iterator[list[str]]:
        yield ["graph", "chi2"]
        yield ["ring", "1.5"]
        raise MfslamError("stopped")

    monkeypatch.setattr(graphs, "TABLES", {"a": ("First", ends_early), "b": ("Second", ends_early)})
    command = ["benchmark_graphs.py", "--data", str(tmp_path), "--markdown", str(page)]
    for name in ("a", "b"):
        monkeypatch.setattr(sys, "argv", [*command, "--only", name])
        assert graphs.main() == 1
        assert capsys.readouterr().err == "benchmark_graphs: stopped\n"
    assert page.read_text().count("| ring | 1.5 |") == 2
