"""What is shown, made once for all browsers, and what one of them does not have of it yet."""

from __future__ import annotations

import base64
import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from mfslam.live.state import LiveState
from mfslam.types import FloatArray
from mfslam.viewer.tiles import TILE_CELLS, TileMap

Int32Array = npt.NDArray[np.int32]
SCAN_STEP_M = 0.005  # points of a scan are told in such steps from the robot: 16 bits reach 163 m


@dataclass(frozen=True, eq=False)
class Snapshot:
    """A state, encoded. ``path_mm`` (K, 2), ``loops`` (L, 2); ``robot`` and ``status`` are JSON-able."""

    robot: dict[str, Any] | None = None
    path_mm: Int32Array = field(default_factory=lambda: np.zeros((0, 2), np.int32))
    loops: Int32Array = field(default_factory=lambda: np.zeros((0, 2), np.int32))
    status: dict[str, Any] = field(default_factory=dict)
    map: TileMap = field(default_factory=TileMap)

    def followed_by(self, state: LiveState) -> Snapshot:
        """The next one; without a grid the map is as it was."""
        return Snapshot(
            robot_json(state),
            np.rint(state.keyframes[:, :2] * 1e3).astype(np.int32),
            np.asarray(state.loops, dtype=np.int32).reshape(-1, 2),
            finite(
                {
                    "health": state.health,
                    "counts": state.counts,
                    "latency_ms": state.latency_ms,
                    "notes": state.notes,
                }
            ),
            self.map if state.grid is None else self.map.updated(state.grid),
        )


@dataclass
class Has:
    """What one browser has been told."""

    snapshot: Snapshot = field(default_factory=Snapshot)
    anything: bool = False


def news(now: Snapshot, has: Has) -> dict[str, Any]:
    """The sections of ``now`` that differ from what the browser has; ``has`` is brought up to date."""
    before, out = has.snapshot, {}
    if now.robot is not before.robot:
        out["robot"] = now.robot
    if now.status != before.status:
        out["status"] = now.status
    for name, new, old in (("path", now.path_mm, before.path_mm), ("loops", now.loops, before.loops)):
        first = first_difference(new, old)
        if first < max(len(new), len(old)):
            out[name] = {"from": first, "rows": to_text(new[first:])}
    if now.map is not before.map or not has.anything:
        out["map"] = _map_news(now.map, before.map)
    has.snapshot, has.anything = now, True
    return out


def robot_json(state: LiveState) -> dict[str, Any]:
    """Pose, covariance and scan."""
    x, y, yaw = state.world_T_body.tolist()
    return {
        "stamp_s": state.stamp_ns * 1e-9,
        "pose": [round(x, 4), round(y, 4), round(yaw, 5)],
        "covariance": finite([float(f"{v:.4g}") for v in state.covariance[np.triu_indices(3)].tolist()]),
        "scan": scan_text(state.scan_points_m, state.world_T_body),
    }


def scan_text(points_m: FloatArray, world_T_body: FloatArray) -> str:
    """World points (N, 2) in steps from the robot's position, base64 of int16."""
    steps = np.rint((points_m - world_T_body[:2]) / SCAN_STEP_M)
    return to_text(steps.clip(-32767, 32767).astype(np.int16))


def to_text(array: npt.NDArray[Any]) -> str:
    """Base64 of an array's bytes, little endian."""
    return base64.b64encode(array.astype(array.dtype.newbyteorder("<")).tobytes()).decode("ascii")


def first_difference(a: npt.NDArray[Any], b: npt.NDArray[Any]) -> int:
    """Number of rows at the beginning that are the same in both."""
    common = min(len(a), len(b))
    differ = (a[:common] != b[:common]).any(axis=1)
    return int(differ.argmax()) if differ.any() else common


def _map_news(now: TileMap, before: TileMap) -> dict[str, Any]:
    """Versions of the tiles that are new or have changed, and the names of those that are gone."""
    same_cells = (now.resolution_m, now.offset_m) == (before.resolution_m, before.offset_m)
    known = before.tiles if same_cells else {}
    return {
        "resolution_m": now.resolution_m,
        "offset_m": now.offset_m,
        "tile_cells": TILE_CELLS,
        "tiles": {
            tile_name(key): tile.version for key, tile in now.tiles.items() if known.get(key) is not tile
        },
        "gone": [tile_name(key) for key in before.tiles if key not in now.tiles],
    }


def tile_name(key: tuple[int, int]) -> str:
    return f"{key[0]}_{key[1]}"


def finite(value: Any) -> Any:
    """JSON knows no NaN and no infinity: null in their place."""
    if isinstance(value, dict):
        return {str(key): finite(inner) for key, inner in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(inner) for inner in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value
