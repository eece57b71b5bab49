"""ROS messages (as rosbags gives them, of either generation) to ours. Each returns None for what is unusable."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from drivers.ros_transforms import heading, rotation, yaw_of
from mfslam.config import WheelsConfig
from mfslam.types import Float32Array, FloatArray, Imu, Odometry, WheelAngles


def header_stamp_ns(message: Any) -> int:
    """0 where the publisher left it empty."""
    stamp = message.header.stamp
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def step_rad(scan: Any) -> float:
    """Bearing between beams; from the ends where the publisher left it empty."""
    told = float(scan.angle_increment)
    return told or float(scan.angle_max - scan.angle_min) / max(1, len(scan.ranges) - 1)


def ranges_of(message: Any) -> Float32Array:
    """Ranges of a LaserScan, or the first echoes of a MultiEchoLaserScan; a copy."""
    if len(message.ranges) and hasattr(message.ranges[0], "echoes"):
        first = [beam.echoes[0] if len(beam.echoes) else math.nan for beam in message.ranges]
        return np.array(first, dtype=np.float32)
    return np.array(message.ranges, dtype=np.float32)


def odometry_of(stamp_ns: int, position: Any, orientation: Any) -> Odometry | None:
    yaw = heading(orientation)
    if yaw is None or not math.isfinite(position.x + position.y):
        return None
    return Odometry(stamp_ns, np.array([position.x, position.y, yaw]))


def imu_of(stamp_ns: int, message: Any, body_R_imu: FloatArray) -> Imu | None:
    """Yaw rate and heading of the body. A covariance that starts with -1 says 'not measured'; an
    orientation that is exactly the identity was never filled in."""
    rate: float | None = None
    if message.angular_velocity_covariance[0] != -1.0:
        omega = message.angular_velocity
        rate = float((body_R_imu @ np.array([omega.x, omega.y, omega.z]))[2])
        if not math.isfinite(rate):
            rate = None
    yaw: float | None = None
    q = message.orientation
    if message.orientation_covariance[0] != -1.0 and (q.x, q.y, q.z, q.w) != (0.0, 0.0, 0.0, 1.0):
        world_R_imu = rotation(q)
        if world_R_imu is not None:
            yaw = yaw_of(world_R_imu @ body_R_imu.T)
    return None if rate is None and yaw is None else Imu(stamp_ns, rate, yaw)


def wheel_joints(names: list[str], wheels: WheelsConfig) -> tuple[str, str] | None:
    """Names of the left and the right wheel's joint: as set, else found by name."""
    left = wheels.left_joint or _find_joint(names, ("left", "_l_", "l_wheel", "wheel_l", "lwheel"))
    right = wheels.right_joint or _find_joint(names, ("right", "_r_", "r_wheel", "wheel_r", "rwheel"))
    if left in names and right in names and left and right:
        return (right, left) if wheels.swap_sides else (left, right)
    return None


def _find_joint(names: list[str], hints: tuple[str, ...]) -> str | None:
    matching = [name for name in names if any(hint in name.lower() for hint in hints)]
    return next((name for name in matching if "wheel" in name.lower()), None)


def wheel_angles_of(stamp_ns: int, message: Any, joints: tuple[str, str]) -> WheelAngles | None:
    names = list(message.name)
    if joints[0] not in names or joints[1] not in names or len(message.position) != len(names):
        return None
    left, right = (float(message.position[names.index(joint)]) for joint in joints)
    return WheelAngles(stamp_ns, left, right) if math.isfinite(left + right) else None
