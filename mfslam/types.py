"""What flows between the rooms of mfslam. A leaf: it imports nothing of ours.

Conventions: stamps are int nanoseconds as the log gives them; offsets inside a scan are float seconds
from that stamp. Poses are (x, y, theta) arrays in metres and radians, named ``parent_T_child``. The body
frame is x forward, y left, theta anticlockwise.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
Float32Array = npt.NDArray[np.float32]
IntArray = npt.NDArray[np.int64]
Int32Array = npt.NDArray[np.int32]
Int8Array = npt.NDArray[np.int8]
BoolArray = npt.NDArray[np.bool_]


class MfslamError(Exception):
    """An error in the user's input: one clear line, saying where, what was expected and what to do."""


@dataclass(frozen=True, eq=False)
class Laser:
    """One laser as it is mounted: geometry and timing shared by all scans that it makes.

    ``angles_rad`` (N,): bearing of each beam in the laser frame, anticlockwise positive (eq. 14).
    ``offsets_s`` (N,): instant of each beam minus the scan's stamp, transport delay included (eq. 15).
    ``body_T_laser`` (3,): the mount.
    ``range_sigma_m``: one-sigma noise of a range.
    """

    name: str
    angles_rad: FloatArray
    offsets_s: FloatArray
    range_min_m: float
    range_max_m: float
    range_sigma_m: float
    body_T_laser: FloatArray

    def __post_init__(self) -> None:
        if self.angles_rad.ndim != 1 or self.angles_rad.shape != self.offsets_s.shape:
            raise ValueError(
                f"laser {self.name}: expected angles and offsets of one shape (N,), "
                f"got {self.angles_rad.shape} and {self.offsets_s.shape}"
            )
        if self.body_T_laser.shape != (3,):
            raise ValueError(f"laser {self.name}: expected body_T_laser of shape (3,)")


@dataclass(frozen=True, eq=False, slots=True)
class Scan:
    """One raw scan, as sensed: nothing compensated.

    ``ranges_m`` (N,) float32: metres; +inf where the beam met nothing in range (free space),
    NaN where nothing can be said (error code, dazzled, too near).
    ``odom_T_body`` (3,): the wheels' pose at the stamp, when the log carries one with the scan.
    """

    stamp_ns: int
    ranges_m: Float32Array
    laser: Laser
    odom_T_body: FloatArray | None = None

    def __post_init__(self) -> None:
        if self.ranges_m.shape != self.laser.angles_rad.shape:
            raise ValueError(
                f"scan at {self.stamp_ns} ns: expected {self.laser.angles_rad.shape[0]} ranges, "
                f"got {self.ranges_m.shape}"
            )


@dataclass(frozen=True, eq=False, slots=True)
class Odometry:
    """Dead-reckoned pose of the body in the odometry frame (arbitrary origin)."""

    stamp_ns: int
    odom_T_body: FloatArray


@dataclass(frozen=True, slots=True)
class WheelTicks:
    """Encoder counters of the two wheels since some start; forward positive."""

    stamp_ns: int
    left: int
    right: int


@dataclass(frozen=True, slots=True)
class WheelAngles:
    """Angles turned by the two wheels since some start (JointState positions); forward positive."""

    stamp_ns: int
    left_rad: float
    right_rad: float


@dataclass(frozen=True, slots=True)
class Imu:
    """Gyro yaw rate and, where there is one, an absolute heading (compass or fused), body frame."""

    stamp_ns: int
    yaw_rate_rad_s: float | None
    yaw_rad: float | None = None


Message = Scan | Odometry | WheelTicks | WheelAngles | Imu


@dataclass(slots=True)
class Finding:
    """One kind of oddity: counted, with the place where it was first seen."""

    text: str
    count: int
    first_where: str


class Findings:
    """Counted warnings in words. Nothing is dropped in silence: whoever drops, says so here."""

    def __init__(self) -> None:
        self._by_code: dict[str, Finding] = {}

    def add(self, code: str, text: str, where: str = "", count: int = 1) -> None:
        """Count an oddity. ``code`` is a stable key (kebab-case), ``text`` says what it is and what was
        done about it, ``where`` a file:line or stamp."""
        known = self._by_code.get(code)
        if known is None:
            self._by_code[code] = Finding(text, count, where)
        else:
            known.count += count

    def merge(self, other: Findings) -> None:
        """Take over what another room has found."""
        for code, finding in other:
            self.add(code, finding.text, finding.first_where, finding.count)

    def __iter__(self) -> Iterator[tuple[str, Finding]]:
        return iter(self._by_code.items())

    def __len__(self) -> int:
        return len(self._by_code)

    def __contains__(self, code: object) -> bool:
        return code in self._by_code

    def count(self, code: str) -> int:
        return self._by_code[code].count if code in self._by_code else 0

    def lines(self) -> list[str]:
        out = []
        for f in self._by_code.values():
            times = f" ({f.count} times" if f.count > 1 else " (once"
            where = f", first at {f.first_where})" if f.first_where else ")"
            out.append(f.text + times + where)
        return out

    def as_json(self) -> list[dict[str, Any]]:
        return [
            {"code": code, "text": f.text, "count": f.count, "first_where": f.first_where}
            for code, f in self._by_code.items()
        ]


@dataclass(frozen=True, eq=False, slots=True)
class DeskewedScan:
    """Points of one scan, each carried to the body frame at one reference instant.

    ``points_m`` (M, 2) and ``normals`` (M, 2) in the body frame at ``reference_ns``; a normal is (0, 0)
    where the neighbourhood is no line. ``beams`` (M,): index of each point's beam in the raw scan.
    """

    reference_ns: int
    points_m: FloatArray
    normals: FloatArray
    beams: IntArray


@dataclass(frozen=True, eq=False, slots=True)
class Match:
    """Outcome of a registration: where the source stands in the reference, and how surely.

    ``information`` (3, 3): inverse covariance of ``ref_T_src`` in the tangent at ``ref_T_src`` (right
    perturbation, order x, y, theta as in gtsam.Pose2). Directions that the scan does not constrain have
    next to none. ``inlier_ratio``: share of source points that found their partner, robustly weighted. ``rms_m``: root mean
    square of the inliers' residuals. ``by_ends`` (3, 3): information beyond that, by where walls end; None: no walls were asked.
    """

    ref_T_src: FloatArray
    information: FloatArray
    inlier_ratio: float
    rms_m: float
    iterations: int
    converged: bool
    by_ends: FloatArray | None = None


EdgeKind = Literal["prior", "odometry", "scan", "ends", "loop", "heading"]


@dataclass(frozen=True, eq=False, slots=True)
class Edge:
    """One factor between keyframes ``i`` and ``j`` (``i == j`` for unary ones), as it stands at the end.

    ``information`` (3, 3) order x, y, theta. ``weight``: what the robust solve left of it, 0 to 1.
    """

    kind: EdgeKind
    i: int
    j: int
    i_T_j: FloatArray
    information: FloatArray
    weight: float = 1.0


@dataclass(frozen=True, slots=True)
class OpenStretch:
    """A part of the path where scan matching left a direction of the world open.

    ``first_scan``, ``last_scan``: where it begins and ends. ``direction_rad``: the open direction against the
    world's x axis, on (-pi/2, pi/2].
    """

    first_scan: int
    last_scan: int
    travelled_m: float
    direction_rad: float


@dataclass(frozen=True, eq=False)
class OccupancyGrid:
    """Map in the ROS convention: -1 unknown, 0 free ... 100 occupied.

    ``occupancy`` (rows, cols) int8, row 0 is the lowest y; ``origin_m`` (2,) is the lower-left corner
    of cell (0, 0).
    """

    origin_m: FloatArray
    resolution_m: float
    occupancy: Int8Array


@dataclass(frozen=True, eq=False)
class PointCloud:
    """Every hit re-projected at its own instant: ``points_m`` (P, 2) world, ``stamps_ns`` (P,)."""

    points_m: FloatArray
    stamps_ns: IntArray


@dataclass
class RunResult:
    """What a run ends with; the room `output` writes it to disk.

    ``stamps_ns`` (S,) and ``world_T_body`` (S, 3): every scan in log order. ``keyframes`` (K,): index of
    each keyframe among the scans. ``edges`` speak in keyframe numbers. ``covariances`` (S, 3, 3): of x, y and
    yaw of every scan, in the world's axes, relative to the first pose. ``summary`` is JSON-able.
    """

    stamps_ns: IntArray
    world_T_body: FloatArray
    keyframes: IntArray
    edges: list[Edge]
    grid: OccupancyGrid
    points: PointCloud
    findings: Findings
    covariances: FloatArray
    open_stretches: list[OpenStretch] = field(default_factory=list)
    summary: dict[str, Any] = field(default_factory=dict)
