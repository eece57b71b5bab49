"""What a viewer, or anybody else, sees of a live run."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from mfslam.types import FloatArray, IntArray, OccupancyGrid


@dataclass(frozen=True, eq=False)
class LiveState:
    """A live run at one moment.

    ``stamp_ns``: of the newest scan that was placed; ``world_T_body`` (3,): where it stands;
    ``local_T_body`` (3,): the same in the frame that never jumps (ROS: odom); ``covariance`` (3, 3): of x, y and
    yaw of ``world_T_body`` in the world's axes, relative to the first pose. ``scan_points_m`` (N, 2): hits of that scan in
    the world. ``keyframes`` (K, 3): world_T_body of the keyframes, as far as they are corrected now; ``loops`` (L, 2):
    keyframe pairs that loops in use join. ``grid``: the newest map, another object when there is a newer one; None
    before the first. ``health``: `SensorHealth.as_json` of each sensor, none in a replay. ``counts``: scans, keyframes,
    loops, scans_waiting (for the map), scans_dropped, keyframe_spacing_percent (100 as configured), back_end_restarts.
    ``latency_ms``: from a scan's being handed over to its pose: see `Latency.as_ms`.
    ``notes``: findings in words, the newest last.
    """

    stamp_ns: int
    world_T_body: FloatArray
    local_T_body: FloatArray
    covariance: FloatArray
    scan_points_m: FloatArray
    keyframes: FloatArray
    loops: IntArray
    grid: OccupancyGrid | None = None
    health: list[dict[str, Any]] = field(default_factory=list)
    counts: dict[str, int] = field(default_factory=dict)
    latency_ms: dict[str, float] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
