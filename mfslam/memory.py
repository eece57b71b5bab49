"""Memory that was freed, and the C library that keeps it."""

import contextlib
import ctypes


def give_memory_back() -> None:
    """Hand what was freed back to the system before large arrays, grids and pictures are made: glibc keeps it."""
    with contextlib.suppress(OSError, AttributeError):  # another C library keeps what it keeps
        ctypes.CDLL("libc.so.6").malloc_trim(0)
