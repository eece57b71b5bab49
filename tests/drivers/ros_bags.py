"""Small bags for tests, message by message, as recorders and careless drivers write them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

Entry = tuple[str, str, Any, int]  # topic, type, message, time of recording in ns
TF = "tf2_msgs/msg/TFMessage"


def store_of(kind: str) -> Any:
    store = get_typestore(Stores.ROS1_NOETIC if kind == "ros1" else Stores.ROS2_HUMBLE)
    if TF not in store.types:
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms\n", TF))
    return store


class Make:
    """Messages of one generation of ROS."""

    def __init__(self, kind: str = "ros2") -> None:
        self.types = store_of(kind).types

    def _new(self, kind: str, /, **values: Any) -> Any:
        return self.types[kind](**values)

    def header(self, stamp_ns: int, frame: str) -> Any:
        sec, nanosec = divmod(stamp_ns, 10**9)
        seq = {"seq": 0} if "seq" in self.types["std_msgs/msg/Header"].__dataclass_fields__ else {}
        stamp = self._new("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
        return self._new("std_msgs/msg/Header", stamp=stamp, frame_id=frame, **seq)

    def quaternion(self, roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0) -> Any:
        (cr, sr), (cp, sp), (cy, sy) = ((math.cos(a / 2), math.sin(a / 2)) for a in (roll, pitch, yaw))
        return self._new(
            "geometry_msgs/msg/Quaternion",
            w=cr * cp * cy + sr * sp * sy,
            x=sr * cp * cy - cr * sp * sy,
            y=cr * sp * cy + sr * cp * sy,
            z=cr * cp * sy - sr * sp * cy,
        )

    def vector(self, *xyz: float) -> Any:
        return self._new("geometry_msgs/msg/Vector3", **dict(zip("xyz", xyz, strict=True)))

    def scan(self, stamp_ns: int, ranges: Sequence[float], frame: str = "laser", **values: Any) -> Any:
        n = len(ranges)
        fields: dict[str, Any] = {
            "angle_min": -math.pi,
            "angle_max": math.pi,
            "angle_increment": 2 * math.pi / n,
            "time_increment": 0.1 / n,
            "scan_time": 0.1,
            "range_min": 0.1,
            "range_max": 10.0,
        }
        return self._new(
            "sensor_msgs/msg/LaserScan",
            header=self.header(stamp_ns, frame),
            ranges=np.asarray(ranges, dtype=np.float32),
            intensities=np.zeros(0, np.float32),
            **(fields | values),
        )

    def multi_echo(self, stamp_ns: int, echoes: Sequence[Sequence[float]]) -> Any:
        plain = self.scan(stamp_ns, [0.0] * len(echoes))
        fields = {k: getattr(plain, k) for k in plain.__dataclass_fields__ if not k.startswith("__")}
        beams = [self._new("sensor_msgs/msg/LaserEcho", echoes=np.array(e, np.float32)) for e in echoes]
        return self._new(
            "sensor_msgs/msg/MultiEchoLaserScan", **(fields | {"ranges": beams, "intensities": []})
        )

    def odometry(
        self, stamp_ns: int, x: float, y: float, yaw: float, child: str = "base_link", q: Any = None
    ) -> Any:
        point = self._new("geometry_msgs/msg/Point", x=x, y=y, z=0.0)
        pose = self._new("geometry_msgs/msg/Pose", position=point, orientation=q or self.quaternion(yaw=yaw))
        twist = self._new(
            "geometry_msgs/msg/Twist", linear=self.vector(0, 0, 0), angular=self.vector(0, 0, 0)
        )
        return self._new(
            "nav_msgs/msg/Odometry",
            header=self.header(stamp_ns, "odom"),
            child_frame_id=child,
            pose=self._new("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=np.zeros(36)),
            twist=self._new("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36)),
        )

    def imu(
        self, stamp_ns: int, rate: float, orientation: Any, measured: bool, frame: str = "base_link"
    ) -> Any:
        return self._new(
            "sensor_msgs/msg/Imu",
            header=self.header(stamp_ns, frame),
            orientation=orientation,
            orientation_covariance=np.array([0.01 if measured else -1.0, *[0.0] * 8]),
            angular_velocity=self.vector(0, 0, rate),
            angular_velocity_covariance=np.zeros(9),
            linear_acceleration=self.vector(0, 0, 9.81),
            linear_acceleration_covariance=np.zeros(9),
        )

    def joints(self, stamp_ns: int, **angles: float) -> Any:
        return self._new(
            "sensor_msgs/msg/JointState",
            header=self.header(stamp_ns, ""),
            name=list(angles),
            position=np.array(list(angles.values())),
            velocity=np.zeros(0),
            effort=np.zeros(0),
        )

    def transform(
        self, parent: str, child: str, xyz: Sequence[float], q: Any = None, stamp_ns: int = 0
    ) -> Any:
        motion = self._new(
            "geometry_msgs/msg/Transform", translation=self.vector(*xyz), rotation=q or self.quaternion()
        )
        stamped = self._new(
            "geometry_msgs/msg/TransformStamped",
            header=self.header(stamp_ns, parent),
            child_frame_id=child,
            transform=motion,
        )
        return self._new(TF, transforms=[stamped])


def write_bag(path: Path, kind: str, entries: Sequence[Entry]) -> Path:
    """``kind``: ros1, sqlite3 or mcap. A ROS 2 bag is a folder."""
    store = store_of(kind)
    if kind == "ros1":
        from rosbags.rosbag1 import Writer as Writer1

        with Writer1(path) as bag1:
            known1: dict[str, Any] = {}
            for topic, name, message, time_ns in entries:
                if topic not in known1:
                    known1[topic] = bag1.add_connection(topic, name, typestore=store)
                bag1.write(known1[topic], time_ns, store.serialize_ros1(message, name))
        return path
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2

    plugin = StoragePlugin.SQLITE3 if kind == "sqlite3" else StoragePlugin.MCAP
    with Writer2(path, version=9, storage_plugin=plugin) as bag2:
        known2: dict[str, Any] = {}
        for topic, name, message, time_ns in entries:
            if topic not in known2:
                known2[topic] = bag2.add_connection(topic, name, typestore=store)
            bag2.write(known2[topic], time_ns, store.serialize_cdr(message, name))
    return path
