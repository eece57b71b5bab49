"""Worlds of a few walls and scans cast in them, for tests of the method."""

from __future__ import annotations

import numpy as np

from drivers.simulator.raycast import cast_beams
from mfslam import se2
from mfslam.kernels import scans
from mfslam.types import FloatArray, Laser, Scan

NO_MOUNT = np.zeros(3)

# 6 m by 5 m with a nook, a door leaf that stands off square, and a pillar: nothing repeats
ROOM = np.array(
    [
        [-3.0, -2.0, 3.0, -2.0],
        [3.0, -2.0, 3.0, 1.0],
        [3.0, 1.0, 4.0, 1.0],
        [4.0, 1.0, 4.0, 3.0],
        [4.0, 3.0, -3.0, 3.0],
        [-3.0, 3.0, -3.0, -2.0],
        [-3.0, 0.5, -2.2, 0.9],
        [1.0, 3.0, 1.0, 2.2],
    ]
)
ROOM_PILLARS = np.array([[1.8, -1.0, 0.2]])
# two bare walls 2 m apart, whose ends no laser of 8 m sees
CORRIDOR = np.array([[-60.0, -1.0, 60.0, -1.0], [-60.0, 1.0, 60.0, 1.0]])
NO_PILLARS = np.zeros((0, 3))


def laser(
    n_beams: int = 720, span_deg: float = 360.0, turn_s: float = 0.0, range_max_m: float = 8.0
) -> Laser:
    """A laser at the body's origin whose beams are sensed one after the other over ``turn_s``."""
    angles = np.radians(np.linspace(-0.5 * span_deg, 0.5 * span_deg, n_beams, endpoint=False))
    return Laser("test", angles, np.linspace(0.0, turn_s, n_beams), 0.05, range_max_m, 0.01, np.zeros(3))


def cast(segments: FloatArray, pillars: FloatArray, world_T_beams: FloatArray, model: Laser) -> FloatArray:
    """True ranges (N,) from the laser's pose at every beam, (N, 3) or one (3,) for all."""
    poses = np.broadcast_to(world_T_beams, (1, model.angles_rad.size, 3))
    n = model.angles_rad.size
    ranges = cast_beams(
        np.ascontiguousarray(poses), model.angles_rad, segments, np.zeros(len(segments)), pillars,
        np.zeros((1, n, 0, 4)), np.zeros((1, n, 0, 3)), model.range_max_m,
    )  # fmt: skip
    return np.asarray(ranges[0])


def moving_scan(
    segments: FloatArray, pillars: FloatArray, world_T_body: FloatArray, twist: FloatArray, model: Laser
) -> Scan:
    """A scan whose every beam is cast from the pose at its own instant; ``world_T_body`` at the stamp."""
    poses = se2.compose(world_T_body, se2.exp(twist * model.offsets_s[:, None]))
    ranges = cast(segments, pillars, se2.compose(poses, model.body_T_laser), model)
    return Scan(1_000_000_000, ranges.astype(np.float32), model)


def along(bearings_rad: FloatArray) -> FloatArray:
    """(N, 2) unit vectors."""
    return np.stack([np.cos(bearings_rad), np.sin(bearings_rad)], axis=1)


def oriented_points(
    segments: FloatArray,
    pillars: FloatArray,
    world_T_body: FloatArray,
    sigma_m: float = 0.0,
    seed: int = 0,
    model: Laser | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Points and normals (M, 2) of a standing scan, in the body frame."""
    model = laser() if model is None else model
    ranges = cast(segments, pillars, world_T_body, model)
    ranges = ranges + np.random.default_rng(seed).normal(0.0, sigma_m, ranges.shape) if sigma_m else ranges
    points, beams = scans.project_beams(
        ranges.astype(np.float32), along(model.angles_rad), model.offsets_s, NO_MOUNT, np.zeros(3),
        model.range_min_m, model.range_max_m,
    )  # fmt: skip
    step = float(model.angles_rad[1] - model.angles_rad[0])
    return points, scans.estimate_normals(points, beams, np.zeros(2), step, max(sigma_m, 0.01))
