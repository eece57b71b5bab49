"""Lines and numbers of a text log: plain, gzip or bzip2, told apart by their first bytes."""

from __future__ import annotations

import bz2
import zlib
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Protocol, Self

from mfslam.types import MfslamError

_CHUNK_BYTES = 1 << 18
_MAGIC_LENGTH = 4
_MAX_STAMP_NS = 9 * 10**18  # the year 2255: what an int64 holds


class _Decompressor(Protocol):
    @property
    def eof(self) -> bool: ...
    @property
    def unused_data(self) -> bytes: ...
    def decompress(self, data: bytes, /) -> bytes: ...


def _decompressor(head: bytes) -> _Decompressor | None:
    if head.startswith(b"\x1f\x8b"):
        return zlib.decompressobj(wbits=31)
    if head.startswith(b"BZh"):
        return bz2.BZ2Decompressor()
    return None


class TextSource:
    """Numbered lines of a text file, with the share of it that was read.

    A compressed file that ends early, or is damaged on the way, gives all lines up to there;
    ``damage`` then says in words what was wrong.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.damage: str | None = None
        self._size_bytes = 1
        self._read_bytes = 0

    def progress(self) -> float:
        return min(1.0, self._read_bytes / self._size_bytes)

    def where(self, line: int) -> str:
        return f"{self.path.name}:{line}"

    def lines(self) -> Iterator[tuple[int, bytes]]:
        """(line number from 1, line without its end). The file is opened anew with each call."""
        rest, number = b"", 0
        for chunk in self._chunks():
            parts = (rest + chunk).split(b"\n")
            rest = parts.pop()
            for part in parts:
                number += 1
                yield number, part
        if rest:
            yield number + 1, rest

    def _chunks(self) -> Iterator[bytes]:
        """Decompressed pieces."""
        self.damage, self._read_bytes = None, 0
        try:
            with self.path.open("rb") as file:
                self._size_bytes = max(1, self.path.stat().st_size)
                decompressor = _decompressor(file.read(_MAGIC_LENGTH))
                file.seek(0)
                while raw := file.read(_CHUNK_BYTES):
                    self._read_bytes += len(raw)
                    if decompressor is None:
                        yield raw
                        continue
                    while raw:
                        if decompressor.eof:  # the next member of a concatenated file
                            decompressor = _decompressor(raw)
                            if decompressor is None:
                                self.damage = "bytes follow the end of the compressed data: left out"
                                return
                        yield decompressor.decompress(raw)
                        raw = decompressor.unused_data
                if decompressor is not None and not decompressor.eof:
                    self.damage = "the compressed file is cut: read up to there"
        except (zlib.error, ValueError, EOFError) as error:
            self.damage = f"the compressed file is damaged ({error}): read up to there"
        except OSError as error:
            if error.strerror is None:  # bz2 reports damaged data so
                self.damage = f"the compressed file is damaged ({error}): read up to there"
                return
            raise MfslamError(f"{self.path}: cannot be read: {error.strerror}") from None

    def head(self, size_bytes: int) -> bytes:
        """The first bytes, decompressed."""
        out = b""
        for chunk in self._chunks():
            out += chunk
            if len(out) >= size_bytes:
                break
        return out[:size_bytes]


class NumberCache(dict[bytes, float]):
    """Text to number. Ranges of a log repeat the same few thousand texts: a look-up beats parsing.

    Raises ValueError for what is no number.
    """

    _LIMIT = 100_000

    def __missing__(self, text: bytes) -> float:
        if len(self) >= self._LIMIT:
            self.clear()
        value = self[text] = float(text)
        return value


def stamp_ns(text: bytes) -> int:
    """Decimal seconds to nanoseconds, exact to the last digit (a float would be 100 ns off today).

    Raises ValueError for what is no finite number, or too large for int64 nanoseconds.
    """
    whole, _, fraction = text.partition(b".")
    if whole.isdigit() and (fraction.isdigit() or not fraction):
        stamp = int(whole) * 1_000_000_000 + int((fraction + b"000000000")[:9])
    else:
        try:
            stamp = round(float(text) * 1e9)
        except OverflowError:
            raise ValueError(f"stamp {text!r} is not finite") from None
    if abs(stamp) > _MAX_STAMP_NS:
        raise ValueError(f"stamp {text!r} is out of range")
    return stamp


class TextLog:
    """What every reader of a `TextSource` is besides: nothing stays open between its lines."""

    _source: TextSource

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        return None

    def progress(self) -> float:
        return self._source.progress()
