"""The surface that several scans saw, as one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mfslam import icp
from mfslam.kernels import cells, poses
from mfslam.types import DeskewedScan, FloatArray

SMOOTHING_M, SURFACE_SPACING_M = 0.1, 0.04  # of surfaces made of several scans


def merged_surface(oriented: Sequence[FloatArray]) -> cells.CellTable:
    """Search structure over the averaged surface of several scans, `placed` in one frame."""
    raw = icp.reference_table(np.concatenate(oriented))
    return icp.reference_table(cells.smooth_surface(raw, icp.CELL_M, SMOOTHING_M, SURFACE_SPACING_M))


def placed(cloud: DeskewedScan, frame_T_body: FloatArray) -> FloatArray:
    """Oriented points (M, 4) of a scan in another frame: x, y, nx, ny."""
    oriented = np.empty((len(cloud.points_m), 4))
    poses.transform_points(frame_T_body, cloud.points_m, cloud.normals, oriented)
    return oriented
