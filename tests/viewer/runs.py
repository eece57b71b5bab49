"""One finished run for all tests of the viewer: the beginning of the demo, mapped by the command."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import pytest
from short_logs import drive

from drivers.writers.log import write_log
from mfslam.cli import main

SCANS = 120


def finished_run(factory: pytest.TempPathFactory) -> Path:
    """Its folder, made once a session."""
    return _made(str(factory.getbasetemp()))


@cache
def _made(base: str) -> Path:
    log, folder = Path(base) / "drive.mcap", Path(base) / "finished-run"
    messages = drive().messages
    write_log(messages[: len(messages) * SCANS // 654], log)
    assert main(["map", str(log), "-o", str(folder), "-q"]) == 0
    return folder
