"""Messages as ROS messages, for both generations of bags.

Topics: /scan (LaserScan; /scan_2 ... for further lasers), /odom (Odometry), /imu (Imu), /joint_states
(JointState with the wheels' angles), /tf_static (base_link to each laser). LaserScan can tell only evenly
timed beams: interlaced ones get their mean slope (counted). Bag times never go backwards, so that a reader
sees the order of the log even where its stamps lie.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from drivers.writers.text import even_step_rad
from mfslam.config import WheelsConfig
from mfslam.types import (
    Findings,
    FloatArray,
    Imu,
    Laser,
    Message,
    MfslamError,
    Odometry,
    Scan,
    WheelAngles,
    WheelTicks,
)

BODY_FRAME, ODOM_FRAME = "base_link", "odom"
LEFT_JOINT, RIGHT_JOINT = "left_wheel_joint", "right_wheel_joint"

RosMessage = tuple[str, str, Any, int]  # topic, type, message, bag time in ns


class RosConverter:
    """Turns messages into ROS messages made of a rosbags typestore's classes. ``upside_down``: how lasers hang."""

    def __init__(
        self,
        types: dict[str, Any],
        findings: Findings,
        wheels: WheelsConfig | None,
        upside_down: bool = False,
    ) -> None:
        self._types = types
        self._findings = findings
        self._wheels, self._upside_down = wheels, upside_down
        self._frames: dict[tuple[str, bytes], str] = {}
        self._slopes: dict[int, tuple[Laser, float]] = {}
        self._last_ns = 0
        self._with_seq = "seq" in types["std_msgs/msg/Header"].__dataclass_fields__

    def convert(self, messages: Iterable[Message]) -> Iterator[RosMessage]:
        """Every message as one or more ROS messages with increasing bag times."""
        odom_told: set[int] = set()  # a scan's own pose is not told twice
        for message in messages:
            if message.stamp_ns < 0:
                raise MfslamError(f"stamp {message.stamp_ns} ns: ROS has no time before 0")
            if isinstance(message, Scan):
                key = (message.laser.name, message.laser.body_T_laser.tobytes())
                if key not in self._frames:
                    number = len(self._frames) + 1
                    self._frames[key] = "laser" if number == 1 else f"laser_{number}"
                    yield self._timed(message, "/tf_static", *self._mount(message, self._frames[key]))
                if message.odom_T_body is not None and message.stamp_ns not in odom_told:
                    odom_told.add(message.stamp_ns)
                    yield self._timed(
                        message, "/odom", *self._odometry(message.stamp_ns, message.odom_T_body)
                    )
                frame = self._frames[key]
                yield self._timed(message, frame.replace("laser", "/scan"), *self._scan(message, frame))
            elif isinstance(message, Odometry):
                odom_told.add(message.stamp_ns)
                yield self._timed(message, "/odom", *self._odometry(message.stamp_ns, message.odom_T_body))
            elif isinstance(message, Imu):
                yield self._timed(message, "/imu", *self._imu(message))
            else:
                yield self._timed(message, "/joint_states", *self._joints(message))

    def _timed(self, message: Message, topic: str, kind: str, ros: Any) -> RosMessage:
        self._last_ns = max(self._last_ns + 1, message.stamp_ns)
        return topic, kind, ros, self._last_ns

    def _make(self, kind: str, **values: Any) -> Any:
        return self._types[kind](**values)

    def _header(self, stamp_ns: int, frame: str) -> Any:
        sec, nanosec = divmod(stamp_ns, 1_000_000_000)
        stamp = self._make("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
        seq = {"seq": 0} if self._with_seq else {}
        return self._make("std_msgs/msg/Header", stamp=stamp, frame_id=frame, **seq)

    def _quaternion(self, yaw_rad: float) -> Any:
        z, w = math.sin(0.5 * yaw_rad), math.cos(0.5 * yaw_rad)
        return self._make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=z, w=w)

    def _rolled(self, yaw_rad: float) -> Any:
        """Half a turn about x, then the yaw."""
        x, y = math.cos(0.5 * yaw_rad), math.sin(0.5 * yaw_rad)
        return self._make("geometry_msgs/msg/Quaternion", x=x, y=y, z=0.0, w=0.0)

    def _vector(self, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Any:
        return self._make("geometry_msgs/msg/Vector3", x=x, y=y, z=z)

    def _scan(self, scan: Scan, frame: str) -> tuple[str, Any]:
        laser, ranges = scan.laser, scan.ranges_m
        step, slope_s = even_step_rad(laser), self._time_increment(laser)
        angles, offsets = laser.angles_rad, laser.offsets_s
        if slope_s < 0.0:  # the laser turns against its beams: ROS counts rays as they are sensed
            angles, offsets, ranges = angles[::-1], offsets[::-1], ranges[::-1].copy()
            step, slope_s = -step, -slope_s
        first_ns = scan.stamp_ns + round(float(offsets[0]) * 1e9)  # ROS: the stamp is of the first ray
        message = self._make(
            "sensor_msgs/msg/LaserScan",
            header=self._header(first_ns, frame),
            angle_min=float(angles[0]),
            angle_max=float(angles[-1]),
            angle_increment=step,
            time_increment=slope_s,
            scan_time=abs(slope_s * 2.0 * math.pi / step),  # one turn
            range_min=laser.range_min_m,
            range_max=laser.range_max_m,
            ranges=ranges,
            intensities=np.zeros(0, np.float32),
        )
        return "sensor_msgs/msg/LaserScan", message

    def _time_increment(self, laser: Laser) -> float:
        """Mean slope of the beams' instants over their number; counted once per laser where it is no line."""
        if id(laser) in self._slopes:
            return self._slopes[id(laser)][1]
        since_first = laser.offsets_s - laser.offsets_s[0]
        beam = np.arange(since_first.shape[0])
        slope = float(np.sum(since_first) / np.sum(beam))
        if np.max(np.abs(since_first - slope * beam)) > 1e-6:
            self._findings.add(
                "uneven-beam-times",
                f"laser {laser.name}: beams are not evenly timed; LaserScan holds only their mean slope",
            )
        self._slopes[id(laser)] = (laser, slope)  # keeps the laser, and so its id
        return slope

    def _odometry(self, stamp_ns: int, odom_T_body: FloatArray) -> tuple[str, Any]:
        x, y, yaw = (float(v) for v in odom_T_body)
        unknown = np.zeros(36)
        pose = self._make(
            "geometry_msgs/msg/Pose",
            position=self._make("geometry_msgs/msg/Point", x=x, y=y, z=0.0),
            orientation=self._quaternion(yaw),
        )
        twist = self._make("geometry_msgs/msg/Twist", linear=self._vector(), angular=self._vector())
        message = self._make(
            "nav_msgs/msg/Odometry",
            header=self._header(stamp_ns, ODOM_FRAME),
            child_frame_id=BODY_FRAME,
            pose=self._make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=unknown),
            twist=self._make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=unknown),
        )
        return "nav_msgs/msg/Odometry", message

    def _imu(self, imu: Imu) -> tuple[str, Any]:
        absent = np.array([-1.0] + [0.0] * 8)  # REP 145: element 0 is -1 where there is no estimate
        message = self._make(
            "sensor_msgs/msg/Imu",
            header=self._header(imu.stamp_ns, BODY_FRAME),
            orientation=self._quaternion(imu.yaw_rad or 0.0),
            orientation_covariance=absent if imu.yaw_rad is None else np.zeros(9),
            angular_velocity=self._vector(z=imu.yaw_rate_rad_s or 0.0),
            angular_velocity_covariance=absent if imu.yaw_rate_rad_s is None else np.zeros(9),
            linear_acceleration=self._vector(),
            linear_acceleration_covariance=absent,
        )
        return "sensor_msgs/msg/Imu", message

    def _joints(self, wheel: WheelTicks | WheelAngles) -> tuple[str, Any]:
        if isinstance(wheel, WheelAngles):
            angles = [wheel.left_rad, wheel.right_rad]
        elif self._wheels is not None:
            angles = [n * 2.0 * math.pi / self._wheels.ticks_per_turn for n in (wheel.left, wheel.right)]
        else:
            raise MfslamError("encoder ticks go into a bag as wheel angles: give wheels.ticks_per_turn")
        message = self._make(
            "sensor_msgs/msg/JointState",
            header=self._header(wheel.stamp_ns, BODY_FRAME),
            name=[LEFT_JOINT, RIGHT_JOINT],
            position=np.array(angles),
            velocity=np.zeros(0),
            effort=np.zeros(0),
        )
        return "sensor_msgs/msg/JointState", message

    def _mount(self, scan: Scan, frame: str) -> tuple[str, Any]:
        x, y, yaw = (float(v) for v in scan.laser.body_T_laser)
        transform = self._make(
            "geometry_msgs/msg/TransformStamped",
            header=self._header(scan.stamp_ns, BODY_FRAME),
            child_frame_id=frame,
            transform=self._make(
                "geometry_msgs/msg/Transform",
                translation=self._vector(x, y),
                rotation=self._rolled(yaw) if self._upside_down else self._quaternion(yaw),
            ),
        )
        return "tf2_msgs/msg/TFMessage", self._make("tf2_msgs/msg/TFMessage", transforms=[transform])
