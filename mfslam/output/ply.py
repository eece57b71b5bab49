"""Point clouds as binary PLY with an instant per point."""

from __future__ import annotations

from typing import IO

import numpy as np

from mfslam.types import PointCloud

VERTEX = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("time", "<f8")])


def write_ply(cloud: PointCloud, file: IO[bytes]) -> None:
    """World points in metres (z is 0) with ``time``, seconds of the log's clock, when the beam was sensed."""
    from plyfile import PlyData, PlyElement

    vertices = np.zeros(len(cloud.points_m), dtype=VERTEX)
    vertices["x"] = cloud.points_m[:, 0]
    vertices["y"] = cloud.points_m[:, 1]
    np.multiply(cloud.stamps_ns, 1e-9, out=vertices["time"])
    PlyData([PlyElement.describe(vertices, "vertex")], byte_order="<").write(file)
