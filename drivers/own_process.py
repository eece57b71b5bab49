"""Start a module of ours as a process of its own, wherever the user stands."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path


def command(module: str, *arguments: str) -> list[str]:
    """What to run. ``-P``: a folder of the user's that has the name of one of our packages does not hide it."""
    return [sys.executable, "-P", "-m", module, *arguments]


def environment() -> dict[str, str]:
    """The environment for it, in which our packages are found first."""
    home = str(Path(__file__).resolve().parent.parent)
    before = os.environ.get("PYTHONPATH")
    return os.environ | {"PYTHONPATH": home if not before else f"{home}{os.pathsep}{before}"}


def start(
    module: str, further: Mapping[str, str] | None = None
) -> tuple[subprocess.Popen[bytes], socket.socket]:
    """The module as a process, told the number of its end of a line, and our end. ``further``: of its environment.

    Not by multiprocessing, which would import the caller's main module again, and with it what that imports. In a session
    of its own: Ctrl-C is ours to answer.
    """
    ours, theirs = socket.socketpair()
    process = subprocess.Popen(
        command(module, str(theirs.fileno())),
        env=environment() | dict(further or {}),
        pass_fds=(theirs.fileno(),),
        start_new_session=True,
    )
    theirs.close()
    return process, ours
