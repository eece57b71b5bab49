"""What a browser is told: always enough to have all of it, and no more than has changed."""

from __future__ import annotations

import base64
import gzip
import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scenes import room, state

from mfslam.types import OccupancyGrid
from mfslam.viewer.snapshot import SCAN_STEP_M, Has, Snapshot, finite, first_difference, news
from mfslam.viewer.tiles import FREE, OCCUPIED, TILE_CELLS, UNKNOWN, TileMap

ROWS = st.lists(st.tuples(st.integers(-2, 2), st.integers(-2, 2)), max_size=6)


def rows_of(text: str, kind: str = "<i4") -> Any:
    return np.frombuffer(base64.b64decode(text), dtype=kind).reshape(-1, 2)


def grid_of(origin: tuple[float, float], occupancy: Any) -> OccupancyGrid:
    return OccupancyGrid(np.array(origin), 0.05, np.asarray(occupancy, dtype=np.int8))


@given(st.lists(st.tuples(ROWS, ROWS, st.booleans()), max_size=6))
def test_news_after_news_give_what_there_is(states: list[tuple[Any, Any, bool]]) -> None:
    """Whatever a browser has missed, what it has kept and what it is told make the newest whole."""
    has, path, loops = Has(), np.zeros((0, 2), np.int32), np.zeros((0, 2), np.int32)
    for new_path, new_loops, looked in states:
        now = Snapshot(
            path_mm=np.array(new_path, np.int32).reshape(-1, 2),
            loops=np.array(new_loops, np.int32).reshape(-1, 2),
        )
        if not looked:  # this one passes while the browser is slow
            continue
        told = news(now, has)
        if "path" in told:
            path = np.vstack([path[: told["path"]["from"]], rows_of(told["path"]["rows"])])
        if "loops" in told:
            loops = np.vstack([loops[: told["loops"]["from"]], rows_of(told["loops"]["rows"])])
        np.testing.assert_array_equal(path, now.path_mm)
        np.testing.assert_array_equal(loops, now.loops)


def test_a_second_look_at_the_same_says_nothing() -> None:
    has, now = Has(), Snapshot().followed_by(state(5, room()))
    assert set(news(now, has)) == {"robot", "status", "path", "loops", "map"}
    assert news(now, has) == {}
    told = news(now.followed_by(state(6)), has)
    assert told["path"]["from"] == 6 and len(rows_of(told["path"]["rows"])) == 1
    assert "map" not in told


def test_a_scan_is_told_to_half_a_step() -> None:
    told = Snapshot().followed_by(state(7)).robot
    assert told is not None
    points = rows_of(told["scan"], "<i2") * SCAN_STEP_M + told["pose"][:2]
    np.testing.assert_allclose(points, state(7).scan_points_m, atol=0.5 * SCAN_STEP_M + 1e-4)


def test_what_is_not_finite_becomes_null() -> None:
    now = Snapshot().followed_by(state(1))
    assert now.status["latency_ms"]["worst"] is None
    assert json.loads(json.dumps(now.robot, allow_nan=False)) == now.robot
    assert finite({"a": [np.float64("inf"), np.int64(3), "x"]}) == {"a": [None, 3, "x"]}


def test_first_difference() -> None:
    a = np.array([[1, 2], [3, 4], [5, 6]])
    assert first_difference(a, a) == 3
    assert first_difference(a, a[:1]) == 1
    assert first_difference(a, np.array([[1, 2], [9, 4], [5, 6]])) == 1


# --- tiles --------------------------------------------------------------------------------------------


def cell(tiles: TileMap, x_m: float, y_m: float) -> int:
    """What the tiles say of a point of the world."""
    col, row = (
        int(np.floor((v - o) / tiles.resolution_m)) for v, o in zip((x_m, y_m), tiles.offset_m, strict=True)
    )
    tile = tiles.tiles.get((col // TILE_CELLS, row // TILE_CELLS))
    return UNKNOWN if tile is None else int(tile.cells[row % TILE_CELLS, col % TILE_CELLS])


@pytest.mark.parametrize("origin", [(0.0, 0.0), (-7.0, 3.05), (12.83, -40.02)])
def test_every_cell_lies_where_the_grid_has_it(origin: tuple[float, float]) -> None:
    rng = np.random.default_rng(3)
    grid = grid_of(origin, rng.choice([-1, 0, 50, 100], (300, 520)))
    tiles = TileMap().updated(grid)
    kinds = {-1: UNKNOWN, 0: FREE, 50: UNKNOWN, 100: OCCUPIED}
    for row, col in rng.integers(0, [300, 520], (400, 2)):
        x, y = grid.origin_m + 0.05 * (np.array([col, row]) + 0.5)
        assert cell(tiles, x, y) == kinds[int(grid.occupancy[row, col])]
    assert cell(tiles, origin[0] - 0.025, origin[1] + 1.0) == UNKNOWN


def test_a_map_that_grows_keeps_the_tiles_that_are_as_they_were() -> None:
    """Two tiles side by side; the grid grows to the left by 40 cells and changes in the right tile only."""
    before = grid_of((0.0, 0.0), np.zeros((256, 512)))
    after = grid_of((-2.0, 0.0), np.full((256, 552), -1))
    after.occupancy[:, 40:] = 0
    after.occupancy[100, 450] = 100
    a = TileMap().updated(before)
    b = a.updated(after)
    assert b.tiles[0, 0] is a.tiles[0, 0] and b.tiles[1, 0].version > a.tiles[1, 0].version
    assert set(b.tiles) == {(0, 0), (1, 0)}  # nothing is known of the new part
    has = Has(Snapshot(map=a), anything=True)
    assert set(news(Snapshot(map=b), has)["map"]["tiles"]) == {"1_0"}
    assert news(Snapshot(map=b.updated(grid_of((0.0, 0.0), np.zeros((256, 256))))), has)["map"]["gone"] == [
        "1_0"
    ]


def test_another_resolution_is_another_map() -> None:
    a = TileMap().updated(room())
    told = news(Snapshot(map=a.updated(room(resolution_m=0.1))), Has(Snapshot(map=a), anything=True))["map"]
    assert told["resolution_m"] == 0.1 and len(told["tiles"]) == 4 and not told["gone"]


def test_a_packed_tile_is_its_bytes() -> None:
    tile = TileMap().updated(room()).tiles[0, 0]
    assert gzip.decompress(tile.packed()) == tile.cells.tobytes()
