"""What changed between two run folders: trajectories, maps, loops, timings."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from mfslam import se2
from mfslam.metrics import PoseError, absolute_errors, align, associate
from mfslam.output import read_graph, read_map, read_tum
from mfslam.output.results import Result, read_result
from mfslam.types import FloatArray, IntArray, MfslamError, OccupancyGrid

SAME_STAMP_S = 1e-6
OCCUPIED = 65
_NEIGHBOURS = 10  # keyframes: edges to those shortly before are matches of the front end and the second pass
NEAR_CELLS = 1  # a wall this near in the other map is the same wall


@dataclass(frozen=True, eq=False)
class Run:
    """A folder that `mfslam map` left: its trajectory, its map, its loops by the stamps they join, its summary."""

    result: Result
    grid: OccupancyGrid
    loops: set[tuple[int, int]]
    summary: dict[str, Any]


@dataclass(frozen=True, eq=False)
class Comparison:
    """Run b against run a. ``picture`` (rows, cols, 3): walls of both, of a alone, of b alone, top row first."""

    data: dict[str, Any]
    seconds: FloatArray
    apart_m: FloatArray
    apart_deg: FloatArray
    a_path: FloatArray
    b_path: FloatArray
    picture: npt.NDArray[np.uint8]


def read_run(folder: Path) -> Run:
    """Raises MfslamError where a file of a run is missing or is not what it should be."""
    if not folder.is_dir():
        raise MfslamError(f"{folder}: expected a folder of `mfslam map`")
    path = folder / "summary.json"
    try:
        summary = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise MfslamError(f"{path}: cannot be read: {(error.strerror or str(error)).lower()}") from None
    except ValueError:
        raise MfslamError(f"{path}: expected the JSON that a run leaves") from None
    if not isinstance(summary, dict):
        raise MfslamError(f"{path}: expected the JSON that a run leaves")
    return Run(read_result(folder), read_map(folder / "map.yaml"), _loops(folder), summary)


def _loops(folder: Path) -> set[tuple[int, int]]:
    """Stamps of keyframes that edges join over more than `_NEIGHBOURS` keyframes."""
    graph = read_graph(folder / "graph.g2o")
    stamps_ns, _ = read_tum(folder / "keyframes.tum")
    if graph.ids.min() < 0 or graph.ids.max() >= len(stamps_ns):
        raise MfslamError(
            f"{folder / 'graph.g2o'}: its vertices are not those of keyframes.tum (0 to {len(stamps_ns) - 1}); map the log again"
        )
    far = np.abs(graph.i - graph.j) > _NEIGHBOURS
    pairs = np.column_stack([stamps_ns[graph.i[far]], stamps_ns[graph.j[far]]])
    return {(int(min(pair)), int(max(pair))) for pair in pairs.tolist()}


def compare_runs(a: Run, b: Run) -> Comparison:
    """Run b is placed on run a by the best fit of their poses of one instant.

    Raises MfslamError when the runs have no instant in common.
    """
    a_ns, b_ns = _stamps(a), _stamps(b)
    i, j = associate(a_ns, b_ns, SAME_STAMP_S)
    of_a, of_b = a.result.world_T_body[i], b.result.world_T_body[j]
    apart = absolute_errors(of_a, of_b, "best")
    a_T_b = align(of_a, of_b)
    picture, walls = _picture(a.grid, b.grid, a_T_b)
    both_loops = a.loops & b.loops
    data = {
        "a": a.result.name,
        "b": b.result.name,
        "trajectories": {
            "poses_a": len(a_ns), "poses_b": len(b_ns), "common": len(i),
            "aligned": PoseError.of(apart).as_json(),
            "as_they_are": PoseError.of(absolute_errors(of_a, of_b, "none")).as_json(),
            "a_T_b": a_T_b,
        },
        "maps": walls,
        "loops": {
            "a": len(a.loops), "b": len(b.loops), "common": len(both_loops),
            "only_a": len(a.loops - b.loops), "only_b": len(b.loops - a.loops),
        },
        "summary": _numbers(a.summary, b.summary),
    }  # fmt: skip
    return Comparison(
        data,
        np.asarray((a_ns[i] - a_ns.min()) * 1e-9),
        np.hypot(apart[:, 0], apart[:, 1]),
        np.degrees(np.abs(apart[:, 2])),
        a.result.world_T_body,
        se2.compose(a_T_b, b.result.world_T_body),
        picture,
    )


def _stamps(run: Run) -> IntArray:
    assert run.result.stamps_ns is not None  # a run folder has them
    return run.result.stamps_ns


def _numbers(a: dict[str, Any], b: dict[str, Any]) -> dict[str, dict[str, float]]:
    """Timings, counts, distances, edges and crispness that both summaries have, of each and how they changed."""
    flat_a, flat_b = _flat(a), _flat(b)
    return {
        key: {"a": flat_a[key], "b": flat_b[key], "change": flat_b[key] - flat_a[key]}
        for key in flat_a
        if key in flat_b and key.partition(".")[0] in ("timings_s", "counts", "distances", "edges", "crispness", "map", "real_time_factor")
    }  # fmt: skip


def _flat(summary: dict[str, Any], prefix: str = "") -> dict[str, float]:
    out: dict[str, float] = {}
    for key, value in summary.items():
        if isinstance(value, dict):
            out |= _flat(value, f"{prefix}{key}.")
        elif isinstance(value, (int, float)) and not isinstance(value, bool):
            out[f"{prefix}{key}"] = float(value)
    return out


def _picture(
    a: OccupancyGrid, b: OccupancyGrid, a_T_b: FloatArray
) -> tuple[npt.NDArray[np.uint8], dict[str, Any]]:
    """Walls of b drawn into the cells of a; both in one frame that holds all of them."""
    cell = a.resolution_m
    walls_a, walls_b = _walls(a), se2.transform(a_T_b, _walls(b))
    every = np.vstack([walls_a, walls_b])
    if not len(every):
        return np.full((1, 1, 3), 255, dtype=np.uint8), {
            "walls_a": 0,
            "walls_b": 0,
            "shared_of_a": 0.0,
            "shared_of_b": 0.0,
        }
    low = np.floor(every.min(axis=0) / cell).astype(np.int64) - 2
    shape = tuple((np.floor(every.max(axis=0) / cell).astype(np.int64) - low + 3)[::-1].tolist())
    if shape[0] * shape[1] > 400_000_000:
        raise MfslamError(f"the maps together would have {shape[1]} x {shape[0]} cells: too many to draw")
    cells_a, cells_b = (_drawn(walls, cell, low, shape) for walls in (walls_a, walls_b))
    near_a, near_b = _thick(cells_a), _thick(cells_b)
    picture = np.full((*shape, 3), 255, dtype=np.uint8)
    picture[cells_a & ~near_b] = (214, 39, 40)
    picture[cells_b & ~near_a] = (31, 119, 180)
    picture[(cells_a & near_b) | (cells_b & near_a)] = (60, 60, 60)
    counts = {
        "walls_a": int(cells_a.sum()),
        "walls_b": int(cells_b.sum()),
        "shared_of_a": float((cells_a & near_b).sum() / max(cells_a.sum(), 1)),
        "shared_of_b": float((cells_b & near_a).sum() / max(cells_b.sum(), 1)),
        "cell_m": cell,
    }
    return picture[::-1], counts


def _walls(grid: OccupancyGrid) -> FloatArray:
    """(W, 2) centres of the occupied cells, m."""
    rows, columns = np.nonzero(grid.occupancy >= OCCUPIED)
    return grid.origin_m + (np.column_stack([columns, rows]) + 0.5) * grid.resolution_m


def _drawn(points: FloatArray, cell: float, low: IntArray, shape: tuple[int, ...]) -> npt.NDArray[np.bool_]:
    out = np.zeros(shape, dtype=np.bool_)
    columns, rows = (np.floor(points / cell).astype(np.int64) - low).T
    out[rows, columns] = True
    return out


def _thick(cells: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """The cells and their neighbours."""
    out = cells.copy()
    for dy in range(-NEAR_CELLS, NEAR_CELLS + 1):
        for dx in range(-NEAR_CELLS, NEAR_CELLS + 1):
            out |= np.roll(cells, (dy, dx), axis=(0, 1))
    return out
