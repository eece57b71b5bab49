"""The map in square pieces: a browser fetches those that have changed."""

from __future__ import annotations

import gzip
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from mfslam.output.maps import FREE_THRESH, OCCUPIED_THRESH
from mfslam.types import OccupancyGrid

Uint8Array = npt.NDArray[np.uint8]
Uint16Array = npt.NDArray[np.uint16]

TILE_CELLS = 256
UNKNOWN, FREE, OCCUPIED = 0, 1, 2

_KIND = np.full(256, UNKNOWN, dtype=np.uint8)  # by the occupancy's byte: -1 is 255
_KIND[:101][np.arange(101) <= 100 * FREE_THRESH] = FREE
_KIND[:101][np.arange(101) >= 100 * OCCUPIED_THRESH] = OCCUPIED


@dataclass(frozen=True, eq=False)
class Tile:
    """``cells`` (256, 256): kind of each cell, lowest row first. ``seen`` (256, 256): when each was first seen,
    where that is known."""

    version: int
    cells: Uint8Array
    seen: Uint16Array | None = None
    _packed: list[bytes] = field(default_factory=list)

    def packed(self) -> bytes:
        """Gzip of the cells' bytes, then those of ``seen`` (little endian)."""
        if not self._packed:  # two browsers at once do it twice, no harm
            seen = b"" if self.seen is None else self.seen.astype("<u2").tobytes()
            self._packed.append(gzip.compress(self.cells.tobytes() + seen, compresslevel=4, mtime=0))
        return self._packed[0]


@dataclass(frozen=True, eq=False)
class TileMap:
    """A map cut along multiples of 256 cells from the world's origin. ``tiles`` by (column, row); those where
    nothing is known are missing. ``offset_m``: of the cells' lower left corners from whole cells of the world."""

    resolution_m: float = 0.05
    offset_m: tuple[float, float] = (0.0, 0.0)
    tiles: Mapping[tuple[int, int], Tile] = field(default_factory=dict)

    def updated(self, grid: OccupancyGrid, seen: Uint16Array | None = None) -> TileMap:
        """The same for a newer grid: tiles that are as they were keep their version."""
        corner = np.floor(grid.origin_m / grid.resolution_m + 0.5).astype(np.int64)
        x, y = np.round(grid.origin_m - corner * grid.resolution_m, 9).tolist()
        like = (grid.resolution_m, (x, y)) == (self.resolution_m, self.offset_m)
        version = 1 + max((tile.version for tile in self.tiles.values()), default=0)
        tiles = {}
        for key, cells, when in _cut(grid, corner, seen):
            before = self.tiles.get(key)
            same = like and before is not None and np.array_equal(before.cells, cells)
            tiles[key] = before if same and before is not None else Tile(version, cells, when)
        return TileMap(grid.resolution_m, (x, y), tiles)


def _cut(
    grid: OccupancyGrid, corner: npt.NDArray[np.int64], seen: Uint16Array | None
) -> Iterator[tuple[tuple[int, int], Uint8Array, Uint16Array | None]]:
    """Key, cells and first sights of every tile that knows something."""
    rows, cols = grid.occupancy.shape
    left, low = corner.tolist()
    for row in range(low // TILE_CELLS, -(-(low + rows) // TILE_CELLS)):
        for col in range(left // TILE_CELLS, -(-(left + cols) // TILE_CELLS)):
            y, x = row * TILE_CELLS - low, col * TILE_CELLS - left
            part = grid.occupancy[max(0, y) : y + TILE_CELLS, max(0, x) : x + TILE_CELLS]
            if not (part >= 0).any():
                continue
            inner = np.s_[max(0, -y) : max(0, -y) + part.shape[0], max(0, -x) : max(0, -x) + part.shape[1]]
            cells = np.zeros((TILE_CELLS, TILE_CELLS), dtype=np.uint8)
            cells[inner] = _KIND[part.view(np.uint8)]
            when = None
            if seen is not None:
                when = np.zeros((TILE_CELLS, TILE_CELLS), dtype=np.uint16)
                when[inner] = seen[max(0, y) : y + TILE_CELLS, max(0, x) : x + TILE_CELLS]
            yield (col, row), cells, when
