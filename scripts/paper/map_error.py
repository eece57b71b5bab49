"""How far a map's walls lie from the true ones: exact, because the simulator knows which wall a beam met."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from mfslam import metrics, se2
from mfslam.config import DeskewConfig
from mfslam.deskew import deskew
from mfslam.types import FloatArray, IntArray, Scan
from paper.rig import Drive, rms

CELL_M = 0.1  # of wall, along it
MIN_POINTS = 10  # a mean of fewer says more of their noise than of the wall
STRETCH_M = 5.0  # of driving, laid onto the truth by itself where drift is to be left out


@dataclass(frozen=True)
class MapError:
    """``rms_m``, ``p95_m``, ``max_m``: of the walls' cells, each the mean signed distance of its points from
    the true wall. ``local_rms_m``: the same with every 5 m of driving laid onto the truth by themselves, so
    that drift does not count. ``points_rms_m``: of the single points. ``ate_m``, ``ate_deg``: of the trajectory."""

    rms_m: float
    p95_m: float
    max_m: float
    local_rms_m: float
    points_rms_m: float
    cells: int
    ate_m: float
    ate_deg: float


@dataclass(frozen=True, eq=False)
class WallCells:
    """The wall that every beam (S, B) truly met. ``cell``: its 10 cm of wall, -1 for none (nothing met, or
    a pillar). ``start_m``, ``normal`` (S, B, 2): a point of that wall and its normal."""

    cell: IntArray
    start_m: FloatArray
    normal: FloatArray


@lru_cache(maxsize=4)
def wall_cells(drive: Drive) -> WallCells:
    hits = drive.hits_m.reshape(-1, 2)
    best = np.full(len(hits), np.inf)
    wall = np.zeros(len(hits), np.int64)
    along = np.zeros(len(hits))
    for k, (x1, y1, x2, y2) in enumerate(drive.world.segments):
        length = float(np.hypot(x2 - x1, y2 - y1))
        tx, ty = (x2 - x1) / length, (y2 - y1) / length
        u = np.clip((hits[:, 0] - x1) * tx + (hits[:, 1] - y1) * ty, 0.0, length)
        off = np.hypot(hits[:, 0] - x1 - u * tx, hits[:, 1] - y1 - u * ty)
        nearer = off < best
        best[nearer], wall[nearer], along[nearer] = off[nearer], k, u[nearer]
    met = best < 1e-6
    most = 1 + int(
        np.max(np.hypot(*np.diff(drive.world.segments.reshape(-1, 2, 2), axis=1)[:, 0].T)) / CELL_M
    )
    cell = np.where(met, wall * most + (along / CELL_M).astype(np.int64), -1)
    ends = drive.world.segments[wall]
    direction = ends[:, 2:] - ends[:, :2]
    direction /= np.hypot(*direction.T)[:, None]
    shape = drive.ranges_m.shape
    normal = np.stack([-direction[:, 1], direction[:, 0]], axis=-1)
    return WallCells(cell.reshape(shape), ends[:, :2].reshape(*shape, 2).copy(), normal.reshape(*shape, 2))


@dataclass(frozen=True, eq=False)
class MapPoints:
    """Every hit of a map: ``points_m`` (P, 2) in the body frame at its scan's reference instant, ``scan`` and
    ``beam`` (P,) where it comes from. ``poses`` (S, 3): of the scans at those instants, in any frame."""

    points_m: FloatArray
    scan: IntArray
    beam: IntArray
    poses: FloatArray

    @staticmethod
    def of(scans: Sequence[Scan], poses: FloatArray, twists: FloatArray, settings: DeskewConfig) -> MapPoints:
        clouds = [deskew(scan, twist, settings) for scan, twist in zip(scans, twists, strict=True)]
        return MapPoints(
            np.concatenate([cloud.points_m for cloud in clouds]),
            np.repeat(np.arange(len(scans)), [len(cloud.beams) for cloud in clouds]),
            np.concatenate([cloud.beams for cloud in clouds]),
            poses,
        )

    def placed(self, poses: FloatArray) -> FloatArray:
        """The points (P, 2) where scans stand at ``poses`` (S, 3)."""
        return se2.transform(poses[self.scan], self.points_m[:, None])[:, 0]

    def in_truth(self, drive: Drive) -> FloatArray:
        """The points (P, 2) after the whole trajectory was laid on the true one by the best rigid fit."""
        return self.placed(se2.compose(metrics.align(drive.world_T_body, self.poses), self.poses))


def map_error(drive: Drive, points: MapPoints) -> MapError:
    """Error of a map and of the trajectory behind it."""
    travelled_m, _ = drive.motion.travel(drive.instants_s)
    stretch = (travelled_m / STRETCH_M).astype(np.int64)
    fitted = np.empty_like(points.poses)
    for k in np.unique(stretch):
        true, estimated = drive.world_T_body[stretch == k], points.poses[stretch == k]
        # about the heading too: the positions of a short straight tell little of it
        fitted[stretch == k] = se2.compose(_mean_fit(true, estimated), estimated)
    walls = wall_cells(drive)
    means, off = _wall_means(walls, points, points.in_truth(drive), np.zeros(len(points.scan), np.int64))
    local, _ = _wall_means(walls, points, points.placed(fitted), stretch[points.scan])
    trajectory = metrics.ate(drive.world_T_body, points.poses)
    return MapError(
        rms_m=rms(means),
        p95_m=float(np.percentile(np.abs(means), 95)),
        max_m=float(np.max(np.abs(means))),
        local_rms_m=rms(local),
        points_rms_m=rms(off),
        cells=len(means),
        ate_m=trajectory.translation_m.rmse,
        ate_deg=trajectory.rotation_deg.rmse,
    )


def _mean_fit(true: FloatArray, estimated: FloatArray) -> FloatArray:
    """(3,) true_T_estimated: mean turn between headings, then mean shift."""
    turn = float(np.mean(se2.wrap(true[:, 2] - estimated[:, 2] - (true[0, 2] - estimated[0, 2]))))
    theta = turn + float(true[0, 2] - estimated[0, 2])
    turned = se2.transform(np.array([0.0, 0.0, theta]), estimated[:, :2])
    return np.array([*np.mean(true[:, :2] - turned, axis=0), theta])


def _wall_means(
    walls: WallCells, points: MapPoints, placed_m: FloatArray, part: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Mean signed distance of the points of each cell of wall, kept apart by ``part`` (P,), and the signed
    distances of all points."""
    at = (points.scan, points.beam)
    met = walls.cell[at] >= 0
    at = (points.scan[met], points.beam[met])
    off = np.sum(walls.normal[at] * (placed_m[met] - walls.start_m[at]), axis=1)
    key = part[met] * (int(walls.cell.max()) + 1) + walls.cell[at]
    _, number, counts = np.unique(key, return_inverse=True, return_counts=True)
    means = np.bincount(number, off) / counts
    return means[counts >= MIN_POINTS], off
