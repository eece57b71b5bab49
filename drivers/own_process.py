"""Start a module of ours as a process of its own, wherever the user stands."""

from __future__ import annotations

import os
import sys
from pathlib import Path


def command(module: str, *arguments: str) -> list[str]:
    """What to run. ``-P``: a folder of the user's that has the name of one of our packages does not hide it."""
    return [sys.executable, "-P", "-m", module, *arguments]


def environment() -> dict[str, str]:
    """The environment for it, in which our packages are found first."""
    home = str(Path(__file__).resolve().parent.parent)
    before = os.environ.get("PYTHONPATH")
    return os.environ | {"PYTHONPATH": home if not before else f"{home}{os.pathsep}{before}"}
