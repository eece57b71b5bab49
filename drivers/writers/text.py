"""What text logs share: compression by suffix, exact stamps, even beams."""

from __future__ import annotations

import bz2
import gzip
import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, cast

import numpy as np

from mfslam.types import Laser, MfslamError


@contextmanager
def text_sink(path: Path, suffix: str) -> Iterator[IO[str]]:
    """``path`` opened for text, compressed as ``suffix`` (.gz, .bz2 or any other) says; same bytes always."""
    with path.open("wb") as raw:
        if suffix == ".gz":
            packed = cast(IO[bytes], gzip.GzipFile("", "wb", 6, raw, mtime=0))
        elif suffix == ".bz2":
            packed = cast(IO[bytes], bz2.BZ2File(raw, "wb"))
        else:
            packed = cast(IO[bytes], raw)
        with io.TextIOWrapper(packed, encoding="ascii", newline="\n") as text:
            yield text


def seconds(stamp_ns: int) -> str:
    """A stamp in seconds, exactly: 6 decimals where they tell all, else 9."""
    sign, (whole, ns) = "-" if stamp_ns < 0 else "", divmod(abs(stamp_ns), 1_000_000_000)
    return f"{sign}{whole}.{ns // 1000:06d}" if ns % 1000 == 0 else f"{sign}{whole}.{ns:09d}"


def even_step_rad(laser: Laser) -> float:
    """The one step from beam to beam, which these formats demand; MfslamError when there is none."""
    n = laser.angles_rad.shape[0]
    if n < 2:
        raise MfslamError(f"laser {laser.name}: expected at least two beams, got {n}")
    step = float(laser.angles_rad[-1] - laser.angles_rad[0]) / (n - 1)
    even = laser.angles_rad[0] + step * np.arange(n)
    if not np.allclose(laser.angles_rad, even, rtol=0.0, atol=1e-6):
        raise MfslamError(f"laser {laser.name}: expected beams at one even step, which this format demands")
    return float(step)
