"""Compile every kernel once, before the work, and say what it costs."""

from __future__ import annotations

import gc
import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from typing import Any

from numba.core.caching import FunctionCache

from mfslam import kernels
from mfslam.kernels.samples import SAMPLES

_MOST_PROCESSES = 4  # more would compile the same helpers again and again


def compile_once(tell: Callable[[str], None]) -> float:
    """Make sure that compiled kernels lie in the cache; returns the CPU seconds it took this process (0: they did).

    Every core takes a share of them, in a process of its own: numba compiles one function at a time.
    """
    newest_s = _newest_source_s()
    if not [kernel for kernel in _kernels() if not _is_cached(kernel, newest_s)]:
        return 0.0
    tell("first run: compiling kernels (once per installation, some 15 to 25 s) ...")
    start_s, start = time.process_time(), os.times()
    processes = min(_MOST_PROCESSES, _cores())
    others = [_compile_apart(SAMPLES[share::processes]) for share in range(1, processes)]
    try:
        _call(SAMPLES[::processes])
        for other in others:
            other.wait()
    finally:
        for other in others:
            other.kill()
    call_all()  # loads what the others compiled, and compiles what they did not
    end = os.times()
    cpu_s = sum(end[:4]) - sum(start[:4])
    tell(
        f"kernels compiled: {end.elapsed - start.elapsed:.0f} s, {cpu_s:.0f} CPU s; later runs load them at once"
    )
    return time.process_time() - start_s


def _cores() -> int:
    """Cores that this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on macOS and Windows
        return os.cpu_count() or 1


def call_all() -> None:
    """Call every kernel."""
    _call(SAMPLES)


def _call(samples: Sequence[Callable[[], None]]) -> None:
    collects = gc.isenabled()
    gc.disable()  # numba makes millions of small objects and keeps most: looking them through is a fifth of its time
    try:
        for sample in samples:
            sample()
    finally:
        if collects:
            gc.enable()


def _compile_apart(samples: Sequence[Callable[[], None]]) -> subprocess.Popen[bytes]:
    """A process that calls these and leaves their kernels in the cache. If it fails, nothing is lost but time."""
    names = [sample.__name__ for sample in samples]
    return subprocess.Popen(
        [sys.executable, "-m", __name__, *names],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


def _kernels() -> list[Any]:
    """All compiled functions of this room that Python calls: those that are cached."""
    modules = (import_module(f"{__package__}.{found.name}") for found in iter_modules(kernels.__path__))
    return [
        item
        for module in modules
        for name, item in vars(module).items()
        if not name.startswith("_") and hasattr(item, "py_func") and item.__module__ == module.__name__
        and isinstance(item._cache, FunctionCache)
    ]  # fmt: skip


def _is_cached(kernel: Any, newest_s: float) -> bool:
    """Whether numba holds a valid compiled version (its cache has no public question for that). One that is older than the
    newest source of this room, at ``newest_s``, is dropped: numba looks at a kernel's own file alone, and not at those of
    the helpers that it was compiled with."""
    if kernel.signatures:
        return True
    try:
        file = kernel._cache._cache_file
        if Path(file._index_path).stat().st_mtime < newest_s:
            file.flush()
        return bool(file._load_index())
    except (AttributeError, OSError):
        return False


def _newest_source_s() -> float:
    """When a source of this room was changed last; by a clock that was ahead then, nothing is told."""
    sources = (source for folder in kernels.__path__ for source in Path(folder).glob("*.py"))
    return max((s for source in sources if (s := source.stat().st_mtime) <= time.time()), default=0.0)


if __name__ == "__main__":
    _call([sample for sample in SAMPLES if sample.__name__ in sys.argv[1:]])
