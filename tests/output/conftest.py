"""A small made-up run: a robot that went twice around a rectangular corridor."""

from __future__ import annotations

import numpy as np
import pytest

from mfslam import se2
from mfslam.types import Edge, Findings, FloatArray, OccupancyGrid, OpenStretch, PointCloud, RunResult

WIDTH_M, HEIGHT_M, HALF_CORRIDOR_M = 24.0, 14.0, 1.2


def path(count: int, laps: float = 2.0) -> FloatArray:
    """Poses (count, 3) along the middle of the corridor, anticlockwise."""
    along = np.linspace(0.0, laps * 2.0 * (WIDTH_M + HEIGHT_M), count) % (2.0 * (WIDTH_M + HEIGHT_M))
    corners = np.cumsum([0.0, WIDTH_M, HEIGHT_M, WIDTH_M, HEIGHT_M])
    x = np.interp(along, corners, [0.0, WIDTH_M, WIDTH_M, 0.0, 0.0])
    y = np.interp(along, corners, [0.0, 0.0, HEIGHT_M, HEIGHT_M, 0.0])
    side = np.minimum(np.searchsorted(corners, along, side="right") - 1, 3)
    return np.stack([x, y, se2.wrap(side * 0.5 * np.pi)], axis=-1)


def make_grid(resolution_m: float = 0.1) -> OccupancyGrid:
    """Corridor free, its walls occupied, all else unknown."""
    origin = np.array([-3.0, -4.0])
    cols, rows = int(31.0 / resolution_m), int(23.0 / resolution_m)
    x = origin[0] + (np.arange(cols) + 0.5) * resolution_m
    y = origin[1] + (np.arange(rows) + 0.5) * resolution_m
    outer = np.maximum(
        np.abs(x - WIDTH_M / 2)[None] - WIDTH_M / 2, np.abs(y - HEIGHT_M / 2)[:, None] - HEIGHT_M / 2
    )
    occupancy = np.full((rows, cols), -1, dtype=np.int8)
    occupancy[np.abs(outer) < HALF_CORRIDOR_M] = 0
    occupancy[np.abs(np.abs(outer) - HALF_CORRIDOR_M) <= 0.5 * resolution_m] = 100
    return OccupancyGrid(origin, resolution_m, occupancy)


def make_result(scans: int = 600, seed: int = 1) -> RunResult:
    rng = np.random.default_rng(seed)
    poses = path(scans)
    keyframes = np.arange(0, scans, 5)
    at = poses[keyframes]
    sigma = np.array([0.01, 0.01, 0.004])
    information = np.diag(sigma**-2)

    def edge(kind: str, i: int, j: int, weight: float = 1.0, weak: bool = False) -> Edge:
        noise = rng.normal(size=3) * sigma
        of_edge = np.diag([1.0, 1e4, 6e4]) if weak else information
        return Edge(kind, i, j, se2.compose(se2.between(at[i], at[j]), noise), of_edge, weight)  # type: ignore[arg-type]

    count = len(keyframes)
    edges = [Edge("prior", 0, 0, at[0], 1e8 * np.eye(3))]
    edges += [edge("scan", n, n + 1, weak=30 < n < 36) for n in range(count - 1)]
    edges += [edge("odometry", n, n + 1) for n in range(count - 1)]
    edges += [edge("loop", n, n + count // 2) for n in range(0, count // 2, 3)]
    edges += [edge("loop", 5, 40, weight=0.0)]
    findings = Findings()
    findings.add("stamp-backwards", "stamps go backwards; scans kept in file order", "log.clf:812", 7)
    stamps = 976_052_857_000_000_123 + np.arange(scans, dtype=np.int64) * 200_000_000
    stamps[50] -= 300_000_000
    hits = poses[rng.integers(0, scans, 5000), :2] + rng.normal(scale=HALF_CORRIDOR_M, size=(5000, 2))
    summary = {
        "log": {"path": "logs/corridor.clf", "format": "CARMEN"},
        "timings_s": {
            "read": 0.8,
            "front_end": 3.4,
            "loop_closure": 2.1,
            "optimise": 0.6,
            "map": 1.2,
            "write": 0.3,
        },
        "loops": {"made": 21, "refused": {"poor_fit": 4, "outside_gate": 11}},
        "real_time_factor": 83.2,
    }
    covariances = np.linspace(0.0, 1.0, scans)[:, None, None] * np.diag([0.02**2, 0.05**2, 0.01**2])
    stretch = OpenStretch(int(keyframes[31]), int(keyframes[36]), 3.2, 0.0)
    return RunResult(
        stamps, poses, keyframes, edges, make_grid(), PointCloud(hits, rng.choice(stamps, 5000)), findings,
        covariances, [stretch], summary,
    )  # fmt: skip


@pytest.fixture
def result() -> RunResult:
    return make_result()
