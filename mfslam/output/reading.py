"""What the strict text readers share."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from mfslam.types import MfslamError


def read_lines(path: Path) -> Iterator[tuple[int, str]]:
    """Numbered lines of a text file, from 1. Raises MfslamError when it is missing or is no text."""
    try:
        with path.open(encoding="utf-8") as file:
            for number, line in enumerate(file, start=1):
                yield number, line.rstrip("\n")
    except OSError as error:
        raise MfslamError(f"{path}: cannot be read: {(error.strerror or str(error)).lower()}") from None
    except UnicodeDecodeError:
        raise MfslamError(f"{path}: expected a text file, got binary data") from None
