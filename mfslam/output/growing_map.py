"""The map of a run that goes on, on disk: at any instant map.yaml names an image that is whole and its own."""

from __future__ import annotations

import time
from pathlib import Path

from mfslam.output import maps
from mfslam.output.staging import write_atomically
from mfslam.types import OccupancyGrid

_STEM = "map-so-far-"


def write_growing_map(folder: Path, grid: OccupancyGrid) -> None:
    """Put a newer map in the place of the one before.

    Each image has a name of its own, and the rename of map.yaml, which nobody sees half done, goes from one pair to
    the next. Whatever kills us leaves the newest whole map, and at most an image that nothing names. Raises
    MfslamError when the disk refuses; the map before stays.
    """
    name = f"{_STEM}{time.time_ns()}.pgm"
    try:
        write_atomically(folder / name, maps.pgm_bytes(maps.grid_image(grid)))
        write_atomically(folder / "map.yaml", maps.yaml_text(grid, name).encode())
    finally:
        clear_growing_maps(folder)


def clear_growing_maps(folder: Path) -> None:
    """Remove images of maps on the way that map.yaml does not name."""
    try:
        first = (folder / "map.yaml").read_text(encoding="utf-8").partition("\n")[0]
    except OSError:
        first = ""
    named = first.removeprefix("image:").strip()
    for path in folder.glob(f"{_STEM}*.pgm"):
        if path.name != named:
            path.unlink(missing_ok=True)
