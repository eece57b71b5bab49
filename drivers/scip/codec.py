"""SCIP 2.0 on the level of characters: 6 bits each, a sum per line. No I/O, no state.

Source: Hokuyo, URG Series Communication Protocol Specification SCIP 2.0 (C-42-03320B).
"""

from __future__ import annotations

import numpy as np

from mfslam.types import IntArray

LINE_CHARS = 64  # data characters of one line, its sum not counted
_OFFSET = 0x30
_HIGHEST = 0x6F


def check_sum(text: bytes) -> int:
    """The character that ends a line: the low 6 bits of the sum of its bytes, plus 0x30."""
    return (sum(text) & 0x3F) + _OFFSET


def with_sum(text: bytes) -> bytes:
    """A line as it is sent, without its line feed."""
    return text + bytes([check_sum(text)])


def without_sum(line: bytes) -> bytes | None:
    """A line without its sum; None where the sum is wrong."""
    return line[:-1] if len(line) > 1 and line[-1] == check_sum(line[:-1]) else None


def without_info_sum(line: bytes) -> tuple[bytes, bool]:
    """A line ``text;sum`` of VV, PP and II replies: the text, and whether the sum is right.

    The ``;`` is not summed. Some sensors (and the specification's own examples) send wrong sums here.
    """
    if len(line) < 2 or line[-2:-1] != b";":
        return line, False
    return line[:-2], line[-1] == check_sum(line[:-2])


def is_data(text: bytes) -> bool:
    """Whether every character lies in the code's range. The sum misses flips of the two high bits; this does not."""
    return not text or (min(text) >= _OFFSET and max(text) <= _HIGHEST)


def decode(text: bytes, width: int) -> IntArray:
    """Values (N,) of ``width`` characters each, big end first. Raises ValueError for text that is no code."""
    if len(text) % width or not is_data(text):
        raise ValueError(f"expected whole values of {width} characters from 0x30 to 0x6f")
    six_bits = np.frombuffer(text, dtype=np.uint8).astype(np.int64).reshape(-1, width) - _OFFSET
    return np.asarray(six_bits @ (64 ** np.arange(width - 1, -1, -1)), dtype=np.int64)


def encode(values: IntArray, width: int) -> bytes:
    """The inverse of `decode`. Raises ValueError for a value that needs more characters."""
    numbers = np.asarray(values, dtype=np.int64)
    if numbers.size and (numbers.min() < 0 or numbers.max() >= 64**width):
        raise ValueError(f"expected values from 0 to {64**width - 1}")
    digits = numbers[:, None] >> (6 * np.arange(width - 1, -1, -1)) & 0x3F
    return (digits + _OFFSET).astype(np.uint8).tobytes()


def to_lines(text: bytes) -> list[bytes]:
    """Data characters as lines of 64 with their sums; a value may straddle two lines."""
    return [with_sum(text[k : k + LINE_CHARS]) for k in range(0, len(text), LINE_CHARS)]
