from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from PIL import Image

from mfslam.output import maps, read_map
from mfslam.types import Int8Array, MfslamError, OccupancyGrid

GRID = OccupancyGrid(np.array([-2.5, 1.25]), 0.05, np.array([[0, 100, -1], [-1, 0, 100]], dtype=np.int8))


def write(folder: Path, grid: OccupancyGrid) -> Path:
    (folder / "map.pgm").write_bytes(maps.pgm_bytes(maps.grid_image(grid)))
    (folder / "map.yaml").write_text(maps.yaml_text(grid))
    return folder / "map.yaml"


@given(
    hnp.arrays(
        np.int8, st.tuples(st.integers(1, 9), st.integers(1, 9)), elements=st.sampled_from([-1, 0, 100])
    )
)
def test_unknown_stays_unknown(tmp_path_factory: pytest.TempPathFactory, occupancy: Int8Array) -> None:
    grid = OccupancyGrid(np.array([3.0, -7.0]), 0.02, occupancy)
    again = read_map(write(tmp_path_factory.getbasetemp(), grid))
    np.testing.assert_array_equal(again.occupancy, occupancy)
    assert again.resolution_m == 0.02
    np.testing.assert_array_equal(again.origin_m, grid.origin_m)


def test_unknown_would_load_as_free_with_nav2s_own_default(tmp_path: Path) -> None:
    path = write(tmp_path, GRID)
    path.write_text(path.read_text().replace("free_thresh: 0.196", "free_thresh: 0.25"))
    assert not (read_map(path).occupancy == -1).any()


def test_top_image_row_is_the_largest_y() -> None:
    np.testing.assert_array_equal(maps.grid_image(GRID), [[205, 254, 0], [254, 0, 205]])


def test_what_is_neither_free_nor_occupied_is_unknown() -> None:
    between = OccupancyGrid(np.zeros(2), 0.05, np.array([[0, 19, 20, 64, 65, 100]], dtype=np.int8))
    np.testing.assert_array_equal(maps.grid_image(between), [[254, 254, 205, 205, 0, 0]])


def test_picture_shows_the_same_greys() -> None:
    image = maps.grid_image(GRID)
    with Image.open(io.BytesIO(maps.png_bytes(image))) as picture:
        np.testing.assert_array_equal(np.asarray(picture.convert("L")), image)


def test_yaml_says_what_map_server_wants() -> None:
    assert maps.yaml_text(GRID).splitlines() == [
        "image: map.pgm",
        "mode: trinary",
        "resolution: 0.05",
        "origin: [-2.500000000, 1.250000000, 0]",
        "negate: 0",
        "occupied_thresh: 0.65",
        "free_thresh: 0.196",
    ]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("mode: trinary", "mode: scale", "mode: expected trinary"),
        ("resolution: 0.05", "resolution: 0", "resolution: expected metres above 0"),
        ("resolution: 0.05", "resolution: fine", "resolution: expected a number"),
        ("origin: [-2.500000000, 1.250000000, 0]", "origin: 3", "origin: expected"),
        ("free_thresh: 0.196", "", "free_thresh: expected a number"),
        ("image: map.pgm", "image: other.pgm", "image: .*other.pgm cannot be read: no such file"),
        ("image: map.pgm", "image: map.yaml", "is no image"),
        ("image: map.pgm", "image: [", "expected the YAML of a map"),
    ],
)
def test_errors_name_the_field(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = write(tmp_path, GRID)
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(MfslamError, match=message):
        read_map(path)
