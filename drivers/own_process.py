"""Start a module of ours as a process of its own, wherever the user stands."""

from __future__ import annotations

import os
import pickle
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any


def command(module: str, *arguments: str) -> list[str]:
    """What to run. ``-P``: a folder of the user's that has the name of one of our packages does not hide it."""
    return [sys.executable, "-P", "-m", module, *arguments]


def environment() -> dict[str, str]:
    """The environment for it, in which our packages are found first."""
    home = str(Path(__file__).resolve().parent.parent)
    before = os.environ.get("PYTHONPATH")
    return os.environ | {"PYTHONPATH": home if not before else f"{home}{os.pathsep}{before}"}


class OwnProcess:
    """A module as a process, told the number of its end of a line. ``further``: of its environment.

    Not by multiprocessing, which would import the caller's main module again, and with it what that imports. In a session
    of its own: Ctrl-C is ours to answer. One thread may read `line` while another one writes.
    """

    def __init__(self, module: str, further: Mapping[str, str] | None = None) -> None:
        self._socket, theirs = socket.socketpair()
        self._process = subprocess.Popen(
            command(module, str(theirs.fileno())),
            env=environment() | dict(further or {}),
            pass_fds=(theirs.fileno(),),
            start_new_session=True,
        )
        theirs.close()
        self.line = Connection(os.dup(self._socket.fileno()))

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def has_ended(self) -> bool:
        return self._process.poll() is not None

    def listen(self, hear: Callable[[Any], None], gone: Callable[[], None]) -> None:
        """Hand on what it says, in a thread of its own; at the end of the line that is told, too."""

        def read() -> None:
            with suppress(EOFError, OSError, pickle.UnpicklingError):
                while True:
                    hear(self.line.recv())
            gone()

        threading.Thread(target=read, daemon=True, name=f"from {self.pid}").start()

    def end(self, patience_s: float = 0.0) -> int:
        """Hang up, by which it ends; killed if it does not by then. Its status."""
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)  # wakes whoever reads or writes, which closing would not
        self._socket.close()
        try:
            return self._process.wait(patience_s)
        except subprocess.TimeoutExpired:
            self._process.kill()
            return self._process.wait()

    def how_it_ended(self) -> str:
        """In words; waits for it."""
        code = self._process.wait()
        return f"was killed ({signal.Signals(-code).name})" if code < 0 else f"ended with status {code}"
