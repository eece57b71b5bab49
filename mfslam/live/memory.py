"""How much memory this process holds, and held at most."""

from __future__ import annotations

import resource
from contextlib import suppress
from pathlib import Path


def peak_mb() -> float:
    """What it held at most, since `forget_peak` where Linux tells it."""
    with suppress(OSError, ValueError):
        for line in Path("/proc/self/status").read_text(encoding="utf-8").splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) / 1024.0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def forget_peak() -> None:
    """Begin anew: what compiling took, or whoever this was forked from, is no measure of what comes."""
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
