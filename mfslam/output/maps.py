"""Occupancy maps that Nav2's map_server and ROS 1's load: map.pgm with map.yaml.

An image holds three greys: 0 occupied, 254 free, 205 unknown. Row 0 is the top (largest y); the origin is
the lower-left corner of the lower-left pixel. free_thresh must be 0.196: with Nav2's own default of 0.25
the grey of unknown, (255 - 205) / 255 = 0.196, would load as free.
"""

from __future__ import annotations

import io
import math
from pathlib import Path

import numpy as np
import numpy.typing as npt

from mfslam.types import MfslamError, OccupancyGrid

Uint8Array = npt.NDArray[np.uint8]

OCCUPIED_GREY, FREE_GREY, UNKNOWN_GREY = 0, 254, 205
OCCUPIED_THRESH, FREE_THRESH = 0.65, 0.196


def grid_image(grid: OccupancyGrid) -> Uint8Array:
    """The grid as greys (rows, cols), top row first; what is neither clearly free nor occupied is unknown."""
    grey_of = np.full(256, UNKNOWN_GREY, dtype=np.uint8)  # by the occupancy's byte: -1 is 255
    known = np.arange(101)
    grey_of[:101][known <= 100 * FREE_THRESH] = FREE_GREY
    grey_of[:101][known >= 100 * OCCUPIED_THRESH] = OCCUPIED_GREY
    image: Uint8Array = grey_of[grid.occupancy.view(np.uint8)]
    return image[::-1]


def pgm_bytes(image: Uint8Array) -> bytes:
    rows, cols = image.shape
    return b"".join([f"P5\n{cols} {rows}\n255\n".encode("ascii"), np.ascontiguousarray(image).data])


def png_bytes(image: Uint8Array, clear_unknown: bool = False) -> bytes:
    """The same greys as a PNG, two bits a pixel; ``clear_unknown`` leaves unknown transparent."""
    from PIL import Image

    greys = np.array([OCCUPIED_GREY, UNKNOWN_GREY, FREE_GREY], dtype=np.uint8)
    index_of_grey = np.zeros(256, dtype=np.uint8)
    index_of_grey[greys] = np.arange(3, dtype=np.uint8)
    picture = Image.fromarray(index_of_grey[image])
    picture.putpalette(np.repeat(greys, 3).tobytes())
    out = io.BytesIO()
    if clear_unknown:
        picture.save(out, format="PNG", bits=2, transparency=1)
    else:
        picture.save(out, format="PNG", bits=2)
    return out.getvalue()


def yaml_text(grid: OccupancyGrid, image_name: str = "map.pgm") -> str:
    x, y = grid.origin_m.tolist()
    return (
        f"image: {image_name}\n"
        "mode: trinary\n"
        f"resolution: {grid.resolution_m:.9g}\n"
        f"origin: [{x:.9f}, {y:.9f}, 0]\n"
        "negate: 0\n"
        f"occupied_thresh: {OCCUPIED_THRESH}\n"
        f"free_thresh: {FREE_THRESH}\n"
    )


def read_map(yaml_path: Path) -> OccupancyGrid:
    """Load a map as Nav2's map_server does (trinary mode): 100 occupied, 0 free, -1 unknown.

    Raises MfslamError, naming the file and the field, for anything it would misread.
    """
    fields = _read_fields(yaml_path)
    if str(fields.get("mode", "trinary")) != "trinary":
        raise MfslamError(f"{yaml_path}: mode: expected trinary, got {fields['mode']!r}")
    resolution_m = _number(fields, "resolution", yaml_path)
    if resolution_m <= 0:
        raise MfslamError(f"{yaml_path}: resolution: expected metres above 0, got {resolution_m}")
    origin = fields.get("origin")
    if not isinstance(origin, list) or len(origin) < 2:
        raise MfslamError(f"{yaml_path}: origin: expected [x, y, yaw], got {origin!r}")
    image = _read_image(yaml_path, str(fields.get("image", "")))
    shade = image / 255.0 if _number(fields, "negate", yaml_path, 0.0) else (255.0 - image) / 255.0
    occupancy = np.full(image.shape, -1, dtype=np.int8)
    occupancy[shade < _number(fields, "free_thresh", yaml_path)] = 0
    occupancy[shade > _number(fields, "occupied_thresh", yaml_path)] = 100
    return OccupancyGrid(np.array([float(v) for v in origin[:2]]), resolution_m, occupancy[::-1].copy())


def _read_fields(path: Path) -> dict[str, object]:
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    try:
        fields = YAML(typ="safe").load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise MfslamError(f"{path}: cannot be read: {(error.strerror or str(error)).lower()}") from None
    except (UnicodeDecodeError, YAMLError):
        raise MfslamError(f"{path}: expected the YAML of a map (image, resolution, origin, ...)") from None
    if not isinstance(fields, dict):
        raise MfslamError(f"{path}: expected the YAML of a map (image, resolution, origin, ...)")
    return fields


def _number(fields: dict[str, object], key: str, path: Path, default: float | None = None) -> float:
    value = fields.get(key, default)
    if isinstance(value, (int, float)) and math.isfinite(value):
        return float(value)
    raise MfslamError(f"{path}: {key}: expected a number, got {value!r}")


def _read_image(yaml_path: Path, name: str) -> Uint8Array:
    from PIL import Image, UnidentifiedImageError

    path = yaml_path.parent / name
    try:
        with Image.open(path) as picture:
            return np.asarray(picture.convert("L"), dtype=np.uint8)
    except (UnidentifiedImageError, Image.DecompressionBombError) as error:
        raise MfslamError(f"{yaml_path}: image: {path} is no image that can be read: {error}") from None
    except OSError as error:
        why = (error.strerror or str(error)).lower()
        raise MfslamError(f"{yaml_path}: image: {path} cannot be read: {why}") from None
