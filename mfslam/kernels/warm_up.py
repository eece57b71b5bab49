"""Compile every kernel once, before the work, and say what it costs."""

from __future__ import annotations

import gc
import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from importlib import import_module
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
    if all(_is_cached(kernel) for kernel in _kernels()):
        return 0.0
    tell("compiling kernels (once per installation, some 15 to 25 s) ...")
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


def _is_cached(kernel: Any) -> bool:
    """Whether numba holds a version that was compiled from today's sources for this processor (its cache has no public
    question for that)."""
    if kernel.signatures:
        return True
    try:
        processor = kernel.targetctx.codegen().magic_tuple()
        return any(processor in key for key in kernel._cache._cache_file._load_index())
    except (AttributeError, OSError):
        return False


if __name__ == "__main__":
    if sys.argv[1:]:
        _call([sample for sample in SAMPLES if sample.__name__ in sys.argv[1:]])
    else:
        compile_once(print)
