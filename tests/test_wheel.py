"""What `pip install` gets: a wheel that carries compiled kernels, or a plain one where they cannot be compiled."""

from __future__ import annotations

import zipfile
from pathlib import Path

import pytest
from hatchling.builders.wheel import WheelBuilder

ROOT = Path(__file__).resolve().parents[1]


def build(folder: Path, monkeypatch: pytest.MonkeyPatch, module: str) -> tuple[Path, list[str]]:
    """The wheel and its files, when kernels are compiled by running ``module`` (an import that is quick)."""
    (folder / "bin").mkdir()
    monkeypatch.setenv("PYTHONPATH", str(folder / "bin"))
    (folder / "bin" / "sitecustomize.py").write_text(module)
    wheel = Path(next(WheelBuilder(str(ROOT)).build(directory=str(folder), versions=["standard"])))
    return wheel, zipfile.ZipFile(wheel).namelist()


def test_a_wheel_carries_what_was_compiled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stand_in = """
import os, pathlib
if pathlib.Path("mfslam/kernels").is_dir():
    folder = pathlib.Path("mfslam/kernels/__pycache__")
    folder.mkdir(exist_ok=True)
    (folder / "poses.compose.nbi").write_text("index")
    (folder / "poses.compose.1.nbc").write_text("code")
    os._exit(0)
"""
    wheel, names = build(tmp_path, monkeypatch, stand_in)
    assert {
        "mfslam/kernels/__pycache__/poses.compose.nbi",
        "mfslam/kernels/__pycache__/poses.compose.1.nbc",
    } < {*names}
    assert not wheel.name.endswith("py3-none-any.whl"), "what is compiled serves one kind of machine"
    assert "mfslam/configs/rplidar-a1.yaml" in names


def test_where_nothing_can_be_compiled_the_wheel_is_plain(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    failing = 'import os, pathlib\nif pathlib.Path("mfslam/kernels").is_dir():\n    os.write(2, b"no compiler\\n")\n    os._exit(3)\n'
    wheel, names = build(tmp_path, monkeypatch, failing)
    assert wheel.name.endswith("py3-none-any.whl")
    assert not [name for name in names if name.endswith((".nbi", ".nbc"))]
    said = "".join(capfd.readouterr())
    assert "kernels were not compiled, the first run will: no compiler" in said
