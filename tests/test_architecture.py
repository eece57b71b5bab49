"""The import contracts cover every room: a new module must find its layer."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


def layers() -> set[str]:
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    named = next(contract["layers"] for contract in contracts if contract["type"] == "layers")
    return set(re.findall(r"[\w.]+", " ".join(named)))


def test_every_module_has_a_layer() -> None:
    rooms = {
        f"mfslam.{path.stem}"
        for path in (ROOT / "mfslam").iterdir()
        if (path.suffix == ".py" and path.stem != "__init__") or (path / "__init__.py").is_file()
    }
    assert rooms <= layers(), "give each of these a layer in pyproject.toml, [tool.importlinter]"


def test_imports_go_one_way() -> None:
    cli = pytest.importorskip("importlinter.cli")
    assert cli.lint_imports(config_filename=str(ROOT / "pyproject.toml"), cache_dir=None) == 0
