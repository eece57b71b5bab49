"""States to show, made up: what an engine would tell of a robot that drives east through a room."""

from __future__ import annotations

from typing import Any

import numpy as np

from mfslam.live.state import LiveState
from mfslam.types import OccupancyGrid

HEALTH: list[dict[str, Any]] = [
    {
        "name": "urg:/dev/ttyACM0", "connected": True, "messages": 90, "rate_hz": 10.0, "delay_s": 0.012, "reconnects": 1,
        "errors": {"checksum": 3}, "text": "running", "advice": "",
    },
    {
        "name": "board:/dev/ttyUSB0", "connected": False, "messages": 9, "rate_hz": 0.0, "delay_s": 0.0, "reconnects": 0,
        "errors": {}, "text": "silent for 2 s", "advice": "",
    },
]  # fmt: skip


def room(metres: float = 6.0, resolution_m: float = 0.05) -> OccupancyGrid:
    """A free square with walls around it, the world's origin in its middle."""
    cells = round(metres / resolution_m)
    occupancy = np.zeros((cells, cells), dtype=np.int8)
    occupancy[[0, -1], :] = occupancy[:, [0, -1]] = 100
    return OccupancyGrid(np.full(2, -0.5 * metres), resolution_m, occupancy)


def state(k: int, grid: OccupancyGrid | None = None) -> LiveState:
    """The ``k``-th state: a step of 5 cm and a keyframe each."""
    angles = np.linspace(0.0, 2.0 * np.pi, 200)
    pose = np.array([0.05 * k - 1.0, 0.2, 0.1])
    keyframes = np.column_stack([0.05 * np.arange(k + 1) - 1.0, np.full(k + 1, 0.2), np.full(k + 1, 0.1)])
    return LiveState(
        stamp_ns=1_700_000_000_000_000_000 + 100_000_000 * k,
        world_T_body=pose,
        local_T_body=pose,
        covariance=np.diag([0.01, 0.04, 0.001]),
        scan_points_m=pose[:2] + 1.5 * np.column_stack([np.cos(angles), np.sin(angles)]),
        keyframes=keyframes,
        loops=np.array([[0, k]] if k > 3 else [], dtype=np.int64).reshape(-1, 2),
        grid=grid,
        health=HEALTH,
        counts={"scans": k + 1, "keyframes": k + 1},
        latency_ms={"median": 3.2, "p99": 8.1, "worst": float("nan")},
        notes=["the wheels are silent"],
    )
