"""The fixed part of a ROS transform tree, and rotations from quaternions."""

from __future__ import annotations

import math
from collections import deque
from typing import Any

import numpy as np

from mfslam.types import FloatArray

_MOVED = 1e-4  # metres, or of a rotation matrix' entries


def frame_name(name: str) -> str:
    """ROS 1 wrote a leading slash, ROS 2 does not."""
    return name.lstrip("/")


def rotation(quaternion: Any) -> FloatArray | None:
    """(3, 3) from a message with x, y, z, w; None when that is not of unit length."""
    q = np.array([quaternion.w, quaternion.x, quaternion.y, quaternion.z], dtype=np.float64)
    norm = float(np.linalg.norm(q))
    if not 0.9 < norm < 1.1:  # NaN fails, too
        return None
    w, x, y, z = q / norm
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def yaw_of(matrix: FloatArray) -> float:
    """Heading of the x axis."""
    return math.atan2(matrix[1, 0], matrix[0, 0])


def heading(quaternion: Any) -> float | None:
    """As `yaw_of` of the `rotation`, without the matrix: for odometry, which comes often."""
    w, x, y, z = quaternion.w, quaternion.x, quaternion.y, quaternion.z
    if not 0.81 < w * w + x * x + y * y + z * z < 1.21:
        return None
    return math.atan2(2.0 * (x * y + w * z), w * w + x * x - y * y - z * z)


def pose_matrix(position: Any, orientation: Any) -> FloatArray | None:
    """(4, 4) from a message's position and quaternion; None when it is not finite or not a rotation."""
    turn = rotation(orientation)
    shift = np.array([position.x, position.y, position.z], dtype=np.float64)
    if turn is None or not np.isfinite(shift).all():
        return None
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = turn, shift
    return out


class TransformTree:
    """Transforms that never change, gathered from /tf_static and the still ones of /tf."""

    def __init__(self) -> None:
        self._edges: dict[tuple[str, str], FloatArray] = {}
        self.moving: set[tuple[str, str]] = set()

    def add(self, message: Any) -> None:
        """Take in a TFMessage. An edge that is seen to move is no longer fixed."""
        for stamped in message.transforms:
            edge = (frame_name(stamped.header.frame_id), frame_name(stamped.child_frame_id))
            parent_T_child = pose_matrix(stamped.transform.translation, stamped.transform.rotation)
            if parent_T_child is None:
                continue
            first = self._edges.setdefault(edge, parent_T_child)
            if np.abs(first - parent_T_child).max() > _MOVED:
                self.moving.add(edge)

    def find(self, body: str, frame: str) -> FloatArray | None:
        """body_T_frame (4, 4) along fixed transforms, up or down; None where no way leads there."""
        steps: dict[str, list[tuple[str, FloatArray]]] = {}
        for edge, parent_T_child in self._edges.items():
            if edge not in self.moving:
                parent, child = edge
                steps.setdefault(parent, []).append((child, parent_T_child))
                steps.setdefault(child, []).append((parent, np.linalg.inv(parent_T_child).astype(np.float64)))
        body, frame = frame_name(body), frame_name(frame)
        reached: dict[str, FloatArray] = {body: np.eye(4)}
        queue = deque([body])
        while queue:
            here = queue.popleft()
            for there, here_T_there in steps.get(here, ()):
                if there not in reached:
                    reached[there] = reached[here] @ here_T_there
                    queue.append(there)
        return reached.get(frame)
