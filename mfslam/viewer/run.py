"""A folder of `mfslam map` as the viewer shows it."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mfslam.output import read_graph, read_map, read_tum
from mfslam.output.results import read_result
from mfslam.types import FloatArray, IntArray, MfslamError
from mfslam.viewer.first_sight import first_sights
from mfslam.viewer.hub import Hub
from mfslam.viewer.server import Show
from mfslam.viewer.snapshot import Snapshot, finite
from mfslam.viewer.tiles import TileMap

STAMP_SLACK_S = 2e-6  # points tell their instants as float seconds since 1970


def show_run(folder: Path) -> Show:
    """Everything that the viewer serves of a finished run. Raises MfslamError with the file that is wrong."""
    run = read_result(folder)
    grid = read_map(folder / "map.yaml")
    assert run.stamps_ns is not None  # of a folder
    keyframe_ns, _ = read_tum(folder / "keyframes.tum")
    graph = read_graph(folder / "graph.g2o")
    points_m, scan_of_point = _points(folder / "points.ply", run.stamps_ns)
    seen = first_sights(grid, run.world_T_body, points_m, scan_of_point)
    hub = Hub()
    pairs = np.column_stack([graph.i, graph.j])
    far = np.abs(graph.i - graph.j) > 1
    hub.show(
        Snapshot(
            path_mm=np.rint(graph.world_T_pose[:, :2] * 1e3).astype(np.int32),
            loops=pairs[far].astype(np.int32),
            status=_status(folder / "summary.json"),
            map=TileMap().updated(grid, seen),
        )
    )
    parts = {
        "trajectory.bin": _table(run.stamps_ns, run.world_T_body, run.covariances),
        "keyframes.bin": np.searchsorted(run.stamps_ns, keyframe_ns).astype("<u4").tobytes(),
        "scans.bin": Scans(points_m, np.searchsorted(scan_of_point, np.arange(len(run.stamps_ns) + 1))),
    }
    hello = {"mode": "run", "title": folder.resolve().name, "save": True}
    return Show(hub, hello, parts, folder)


def _table(stamps_ns: IntArray, world_T_body: FloatArray, covariances: FloatArray | None) -> bytes:
    """Rows of seconds since the first scan, pose, and xx, xy, yy, yawyaw of its covariance (NaN: not known)."""
    table = np.full((len(stamps_ns), 8), np.nan, dtype="<f4")
    table[:, 0] = np.maximum.accumulate(stamps_ns - stamps_ns[0]) * 1e-9
    table[:, 1:4] = world_T_body
    if covariances is not None:
        table[:, 4:] = covariances[:, [0, 0, 1, 2], [0, 1, 1, 2]]
    return table.tobytes()


@dataclass(frozen=True, eq=False)
class Scans:
    """Hits of some scans on demand: ``bounds`` (S + 1,) says which rows of ``points_m`` a scan has."""

    points_m: FloatArray
    bounds: IntArray

    def __call__(self, first: int = 0, count: int = 1) -> bytes:
        """Number of scans, number of hits of each (uint32), x and y of all (float32). Raises ValueError."""
        last = min(first + count, len(self.bounds) - 1)
        if not 0 <= first < last:
            raise ValueError(f"no scans from {first} on")
        bounds = self.bounds[first : last + 1]
        head = np.array([last - first, *np.diff(bounds)], dtype="<u4").tobytes()
        return head + self.points_m[bounds[0] : bounds[-1]].astype("<f4").tobytes()


def _points(path: Path, stamps_ns: IntArray) -> tuple[FloatArray, IntArray]:
    """Hits (P, 2) in the order of their scans, and the scan of each (P,). Raises MfslamError."""
    from plyfile import PlyData, PlyParseError

    try:
        vertices = PlyData.read(path)["vertex"]
        points_m = np.column_stack([vertices["x"], vertices["y"]]).astype(np.float64)
        seconds = np.asarray(vertices["time"], dtype=np.float64)
    except OSError as error:
        raise MfslamError(f"{path}: cannot be read: {(error.strerror or str(error)).lower()}") from None
    except (PlyParseError, KeyError, ValueError) as error:
        raise MfslamError(f"{path}: expected the points of a run (x, y, time): {error}") from None
    begun_s = np.maximum.accumulate(stamps_ns) * 1e-9 - STAMP_SLACK_S
    scan = np.searchsorted(begun_s, seconds, side="right").clip(1) - 1
    order = np.argsort(scan, kind="stable")
    return points_m[order], scan[order]


def _status(path: Path) -> dict[str, Any]:
    """Counts and notes of a run; a summary that is missing tells nothing."""
    try:
        summary = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    except (OSError, ValueError) as error:
        raise MfslamError(f"{path}: cannot be read: {error}") from None
    counts = dict(summary.get("counts", {}))
    counts["travelled_m"] = summary.get("distances", {}).get("travelled_m")
    counts["loops"] = summary.get("loops", {}).get("in_use")
    findings = summary.get("findings", [])
    notes = [str(f["text"]) for f in findings if isinstance(f, dict) and "text" in f]
    return dict(finite({"counts": {k: v for k, v in counts.items() if v is not None}, "notes": notes}))
