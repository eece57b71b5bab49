"""One finished run for all tests of the viewer: the demo, mapped by the command."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import pytest

from mfslam.cli import main


def finished_run(factory: pytest.TempPathFactory) -> Path:
    """Its folder, made once a session."""
    return _made(str(factory.getbasetemp()))


@cache
def _made(base: str) -> Path:
    folder = Path(base) / "finished-run"
    assert main(["demo", "-o", str(folder), "-q"]) == 0
    return folder
