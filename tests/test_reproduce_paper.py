"""scripts/reproduce_paper.py: the short version of the page, and what it says to bad input."""

from __future__ import annotations

import importlib.util
import json
import re
import sys
from pathlib import Path
from types import ModuleType

import pytest

from mfslam.types import MfslamError

SCRIPT = Path(__file__).resolve().parent.parent / "scripts" / "reproduce_paper.py"


@pytest.fixture(scope="module")
def reproduce() -> ModuleType:
    if str(SCRIPT.parent) not in sys.path:
        sys.path.insert(0, str(SCRIPT.parent))
    spec = importlib.util.spec_from_file_location("reproduce_paper", SCRIPT)
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def made(reproduce: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a short run of the paper's own sections."""
    out: Path = tmp_path_factory.mktemp("page")
    sections = ["equations", "scan_error", "aisles", "graph_on_top"]
    assert reproduce.main(["--quick", "--jobs", "1", "-o", str(out), "--only", *sections]) == 0
    return out


def test_page_holds_every_section_and_every_picture_it_speaks_of(made: Path) -> None:
    page = (made / "paper.md").read_text(encoding="utf-8")
    for title in (
        "The equations",
        "The error within a scan",
        "Experiment 1, square aisle",
        "The graph on top",
    ):
        assert title in page
    pictures = re.findall(r"!\[[^]]*\]\(([^)]+)\)", page)
    assert len(pictures) >= 5
    for picture in pictures:
        assert (made / picture).stat().st_size > 1000
    assert "Short version" in page
    assert "nan" not in page


def test_numbers_of_the_page_are_in_the_json(made: Path) -> None:
    numbers = json.loads((made / "images" / "paper" / "numbers.json").read_text(encoding="utf-8"))
    at3 = numbers["scan_error"]["measured"]["3 m/s"]
    assert at3["none"]["last_x_m"] == pytest.approx(
        -0.1, abs=0.002
    )  # v x 33.3 ms, from the middle of the scan
    assert at3["pose, wheels"]["systematic_rms_m"] < at3["none"]["systematic_rms_m"] / 20.0
    assert set(numbers["aisles"]["measured"]["square-aisle"]) == {
        "convergence",
        "ms_for_15_iterations",
        "maps",
    }
    table = (made / "paper.md").read_text(encoding="utf-8")
    assert f"{1e3 * at3['range']['systematic_rms_m']:.1f}" in table


def test_one_section_again_leaves_the_others_as_they_were(
    reproduce: ModuleType, made: Path, tmp_path: Path
) -> None:
    figures = tmp_path / "images" / "paper"
    figures.mkdir(parents=True)
    before = (made / "images" / "paper" / "numbers.json").read_text(encoding="utf-8")
    (figures / "numbers.json").write_text(before, encoding="utf-8")
    told = tmp_path / "told.json"
    arguments = ["--quick", "-o", str(tmp_path), "--only", "equations", "--json", str(told)]
    assert reproduce.main(arguments) == 0
    assert list(json.loads(told.read_text(encoding="utf-8"))) == ["equations"]
    after = json.loads((figures / "numbers.json").read_text(encoding="utf-8"))
    was = json.loads(before)
    assert list(after) == list(was)
    assert after["aisles"] == was["aisles"]
    assert after["equations"]["measured"] == was["equations"]["measured"]


def test_numbers_that_are_none_are_named(reproduce: ModuleType, tmp_path: Path) -> None:
    figures = tmp_path / "images" / "paper"
    figures.mkdir(parents=True)
    (figures / "numbers.json").write_text("{broken", encoding="utf-8")
    with pytest.raises(MfslamError, match=r"numbers\.json: expected the numbers of an earlier run"):
        reproduce.main(["--quick", "-o", str(tmp_path), "--only", "equations"])


def test_folder_that_cannot_be_made_is_named(reproduce: ModuleType, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(MfslamError, match="cannot be made"):
        reproduce.main(["--quick", "-o", str(tmp_path / "file"), "--only", "equations"])


@pytest.mark.parametrize("arguments", [["--jobs", "0"], ["--only", "nonsense"]])
def test_arguments_that_mean_nothing_are_refused(reproduce: ModuleType, arguments: list[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        reproduce.main(arguments)
    assert stop.value.code == 2


def test_short_run_never_takes_the_place_of_the_page(reproduce: ModuleType) -> None:
    assert reproduce.parse_arguments(["--quick"]).out.name == "paper"
    assert reproduce.parse_arguments([]).out.name == "docs"
