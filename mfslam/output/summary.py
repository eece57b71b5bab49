"""What a run amounts to, in numbers: the content of summary.json and of the report's tables."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import numpy as np

from mfslam import se2
from mfslam.metrics import crispness
from mfslam.types import Edge, EdgeKind, FloatArray, IntArray, RunResult

KINDS: tuple[EdgeKind, ...] = ("scan", "ends", "loop", "odometry", "heading", "prior")
CRISPNESS_CELL_M = 0.02
SATISFIED_M, SATISFIED_DEG = 0.2, 1.0  # as others publish it: loops violated by less, of all


@dataclass(frozen=True, eq=False)
class Residuals:
    """What the final trajectory leaves of each edge (E,).

    ``translation_m`` and ``rotation_rad``: size of log(inverse(i_T_j) * estimate). ``sigmas``: the same
    in units of its own noise, the square root of the Mahalanobis distance.
    """

    translation_m: FloatArray
    rotation_rad: FloatArray
    sigmas: FloatArray


def edge_residuals(world_T_keyframe: FloatArray, edges: list[Edge]) -> Residuals:
    """Residuals of all edges at keyframe poses (K, 3)."""
    if not edges:
        return Residuals(np.zeros(0), np.zeros(0), np.zeros(0))
    i = np.array([edge.i for edge in edges])
    j = np.array([edge.j for edge in edges])
    measured = np.array([edge.i_T_j for edge in edges], dtype=np.float64)
    information = np.array([edge.information for edge in edges], dtype=np.float64)
    unary = (i == j)[:, None]
    estimate = np.where(unary, world_T_keyframe[j], se2.between(world_T_keyframe[i], world_T_keyframe[j]))
    xi = se2.log(se2.between(measured, estimate))
    squared = np.einsum("ea,eab,eb->e", xi, information, xi)
    # a weak or missing direction (a heading factor says nothing of x and y) is no residual
    seen = (information[:, 0, 0] > 0) & (information[:, 1, 1] > 0)
    return Residuals(
        np.where(seen, np.hypot(xi[:, 0], xi[:, 1]), 0.0), np.abs(xi[:, 2]), np.sqrt(np.maximum(squared, 0.0))
    )


def travelled_m(world_T_body: FloatArray) -> float:
    """Length of the path through all poses (N, 3)."""
    return float(np.hypot(*np.diff(world_T_body[:, :2], axis=0).T).sum()) if len(world_T_body) > 1 else 0.0


def forward_seconds(stamps_ns: IntArray) -> FloatArray:
    """Seconds since the first scan; where the log's stamps go backwards, the clock stands still."""
    if len(stamps_ns) == 0:
        return np.zeros(0)
    return np.asarray((np.maximum.accumulate(stamps_ns) - stamps_ns[0]) * 1e-9)


def summarise(result: RunResult) -> dict[str, Any]:
    """Counts, distances, edges and findings of a result, under what its own summary says already."""
    poses = result.world_T_body
    keyframes = result.world_T_body[result.keyframes]
    turn_deg = np.degrees(np.abs(se2.wrap(np.diff(poses[:, 2]))).sum())
    grid = result.grid
    rows, cols = grid.occupancy.shape
    cell_m2 = grid.resolution_m**2
    own: dict[str, Any] = {
        "counts": {
            "scans": len(result.stamps_ns),
            "keyframes": len(result.keyframes),
            "edges": len(result.edges),
            "points": len(result.points.points_m),
        },
        "distances": {
            "log_duration_s": float(forward_seconds(result.stamps_ns)[-1]) if len(poses) else 0.0,
            "travelled_m": travelled_m(poses),
            "turned_deg": float(turn_deg),
        },
        "map": {
            "width_m": cols * grid.resolution_m,
            "height_m": rows * grid.resolution_m,
            "resolution_m": grid.resolution_m,
            "free_m2": float(np.count_nonzero((grid.occupancy >= 0) & (grid.occupancy < 65)) * cell_m2),
            "occupied_cells": int(np.count_nonzero(grid.occupancy >= 65)),
        },
        "edges": _per_kind(keyframes, result.edges),
        "uncertainty": _uncertainty(result.covariances),
        "loops": loops_in_use(keyframes, result.edges),
        "crispness": {"cell_m": CRISPNESS_CELL_M}
        | crispness(result.points.points_m, CRISPNESS_CELL_M).as_json(),
    }
    for section, values in result.summary.items():
        known = own.get(section)
        own[section] = known | values if isinstance(known, dict) and isinstance(values, dict) else values
    if result.open_stretches:
        own["open_stretches"] = [
            {
                "from_stamp_s": float(result.stamps_ns[stretch.first_scan] * 1e-9),
                "to_stamp_s": float(result.stamps_ns[stretch.last_scan] * 1e-9),
                "travelled_m": stretch.travelled_m,
                "open_direction_deg": float(np.degrees(stretch.direction_rad)),
            }
            for stretch in result.open_stretches
        ]
    own["findings"] = result.findings.as_json()
    return own


def _uncertainty(covariances: FloatArray) -> dict[str, float]:
    """One-sigma uncertainty of the poses (N, 3, 3), in the direction in which it is largest."""
    if not len(covariances):
        return {}
    sigma_m = np.sqrt(np.linalg.eigvalsh(covariances[:, :2, :2])[:, 1].clip(min=0.0))
    sigma_deg = np.degrees(np.sqrt(covariances[:, 2, 2]))
    return {
        "position_median_m": float(np.median(sigma_m)),
        "position_largest_m": float(sigma_m.max()),
        "heading_median_deg": float(np.median(sigma_deg)),
        "heading_largest_deg": float(sigma_deg.max()),
    }


def _per_kind(world_T_keyframe: FloatArray, edges: list[Edge]) -> dict[str, dict[str, float]]:
    residuals = edge_residuals(world_T_keyframe, edges)
    kinds = np.array([edge.kind for edge in edges])
    weights = np.array([edge.weight for edge in edges])
    out: dict[str, dict[str, float]] = {}
    for kind in KINDS:
        of_kind = kinds == kind if len(edges) else np.zeros(0, dtype=bool)
        if not of_kind.any():
            continue
        out[kind] = {
            "count": int(of_kind.sum()),
            "rejected": int((weights[of_kind] < 0.5).sum()),
            "residual_median_m": float(np.median(residuals.translation_m[of_kind])),
            "residual_median_deg": float(np.degrees(np.median(residuals.rotation_rad[of_kind]))),
            "residual_median_sigmas": float(np.median(residuals.sigmas[of_kind])),
        }
    return out


def loops_in_use(world_T_keyframe: FloatArray, edges: list[Edge]) -> dict[str, Any]:
    """How many loops the final solution rests on, how many of those it satisfies, and how many it refused."""
    loops = [edge for edge in edges if edge.kind == "loop"]
    residuals = edge_residuals(world_T_keyframe, loops)
    used = np.array([edge.weight >= 0.5 for edge in loops], dtype=np.bool_)
    satisfied = (residuals.translation_m < SATISFIED_M) & (np.degrees(residuals.rotation_rad) < SATISFIED_DEG)
    return {
        "in_use": int(used.sum()),
        "in_use_satisfied": int((used & satisfied).sum()),
        "in_use_satisfied_percent": 100.0 * float(satisfied[used].mean()) if used.any() else None,
        "refused_by_the_last_solve": int((~used).sum()),
        "satisfied_means": f"violated by less than {SATISFIED_M:g} m and {SATISFIED_DEG:g} deg after the final solve",
    }


def json_text(data: Any) -> str:
    """Strict JSON (no NaN: null instead), numpy numbers and arrays included."""
    return json.dumps(_plain(data), indent=2, allow_nan=False) + "\n"


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, float) and not np.isfinite(value):
        return None
    if value is None or isinstance(value, (str, int, float)):
        return value
    return str(value)
