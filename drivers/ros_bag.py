"""Reader of ROS 1 and ROS 2 bags: LaserScan or MultiEchoLaserScan, Odometry, Imu, JointState, /tf."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self

import numpy as np

from drivers.base import LogInfo, NoScans, TopicChoice
from drivers.laser_models import LogGeometry, clean_ranges, laser_from
from drivers.ros_messages import header_stamp_ns, imu_of, odometry_of, ranges_of, step_rad, wheel_angles_of
from drivers.ros_reader import BagReader
from drivers.ros_survey import BagSurvey, survey
from drivers.ros_transforms import frame_name, yaw_of
from drivers.stamp_watch import StampWatch
from mfslam.config import Config
from mfslam.types import Findings, FloatArray, Laser, Message, Scan

_MAX_RANGE_M = 1e4  # a range_max beyond this says nothing


class RosBagLog:
    """A ROS bag: a `drivers.base.Log`. Stamps are the headers'; the order is the bag's.

    Raises MfslamError where it cannot be read, NoScans where no topic has scans.
    """

    def __init__(
        self, path: Path, kind: Literal["ros1", "ros2"], config: Config, topics: TopicChoice | None = None
    ) -> None:
        self.findings = Findings()
        self._config = config
        self._reader = BagReader(path, self.findings)
        try:
            self._found = survey(self._reader, config, topics or TopicChoice(), self.findings)
        except BaseException:
            self._reader.close()
            raise
        self._lasers: dict[tuple[Any, ...], Laser] = {}
        self._body_R_imu: dict[str, FloatArray] = {}
        self._latest: tuple[Laser, Scan] | None = None
        self.info = LogInfo(path, kind, _details(self._reader, self._found))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._reader.close()

    def progress(self) -> float:
        span = self._reader.end_ns - self._reader.start_ns
        return min(1.0, max(0.0, (self._reader.last_bag_time_ns - self._reader.start_ns) / max(1, span)))

    def __iter__(self) -> Iterator[Message]:
        found, stamps, n_scans = self._found, StampWatch(self.findings), 0
        self._reader.last_bag_time_ns = self._reader.start_ns
        for topic, bag_time_ns, message in self._reader.messages(found.connections):
            if topic in found.transform_topics:
                yield from self._odometry_transforms(message)
                continue
            stamp_ns = header_stamp_ns(message)
            if stamp_ns == 0:
                text = f"message of {topic} has an empty stamp: the time of recording is used"
                self.findings.add(f"stamp-empty-{topic}", text, f"{bag_time_ns} ns")
                stamp_ns = bag_time_ns
            if topic == found.scan_topic:
                scan = self._scan(message, stamp_ns)
                if scan is not None:
                    stamps.see(stamp_ns, f"{stamp_ns} ns")
                    n_scans += 1
                    yield scan
            else:
                other = self._other(topic, stamp_ns, message)
                if other is not None:
                    yield other
        self._reader.last_bag_time_ns = self._reader.end_ns
        if not n_scans:
            raise NoScans(
                f"{self.info.path}: no usable scan in {found.scan_topic}: none has two beams or more"
            )

    def _scan(self, message: Any, stamp_ns: int) -> Scan | None:
        ranges = ranges_of(message)
        if ranges.size < 2 or not math.isfinite(message.angle_min + message.angle_increment):
            text = "scan without beams, or with bearings that are not numbers: left out"
            self.findings.add("scan-empty", text, f"{stamp_ns} ns")
            return None
        laser = self._laser(message, ranges.size, stamp_ns)
        scan = Scan(stamp_ns, clean_ranges(ranges, laser), laser)
        if self._latest is not None:
            before = self._latest[1]
            same = before.stamp_ns == stamp_ns and before.laser is laser
            if same and np.array_equal(before.ranges_m, scan.ranges_m, equal_nan=True):
                self.findings.add(
                    "scan-duplicate", "the very same scan a second time: left out", f"{stamp_ns} ns"
                )
                return None
        self._latest = (laser, scan)
        return scan

    def _laser(self, message: Any, n_beams: int, stamp_ns: int) -> Laser:
        key = (
            frame_name(message.header.frame_id),
            n_beams,
            round(float(message.angle_min), 5),
            round(float(message.angle_increment), 7),
            float(message.range_min),
            float(message.range_max),
        )
        laser = self._lasers.get(key)
        if laser is None:
            laser = self._lasers[key] = self._new_laser(message, n_beams, key[0])
        if self._latest is not None and self._latest[0] is not laser:
            text = f"the laser's number of beams or geometry changes, here to {n_beams} beams: followed"
            self.findings.add("laser-changed", text, f"{stamp_ns} ns")
        return laser

    def _new_laser(self, message: Any, n_beams: int, frame: str) -> Laser:
        body_T_laser = self._found.tree.find(self._found.body_frame, frame)
        pose = None
        if body_T_laser is not None:
            pose = (float(body_T_laser[0, 3]), float(body_T_laser[1, 3]), yaw_of(body_T_laser))
        range_min, range_max = float(message.range_min), float(message.range_max)
        told = LogGeometry(
            n_beams,
            float(message.angle_min),
            step_rad(message),
            turn_period_s=self._found.turn_period_s,
            range_min_m=range_min if 0.0 < range_min < _MAX_RANGE_M else None,
            range_max_m=range_max if max(0.0, range_min) < range_max < _MAX_RANGE_M else None,
            body_T_laser=pose,
            upside_down=body_T_laser is not None and body_T_laser[2, 2] < 0.0,
        )
        return laser_from(self._config.sensor, told, name=frame or None)

    def _other(self, topic: str, stamp_ns: int, message: Any) -> Message | None:
        found, out = self._found, None
        if topic == found.odometry_topic:
            out = odometry_of(stamp_ns, message.pose.pose.position, message.pose.pose.orientation)
        elif topic == found.imu_topic:
            return self._imu(stamp_ns, message)
        elif topic == found.wheel_topic and found.joints is not None:
            if not any(joint in message.name for joint in found.joints):
                return None  # other joints speak on the same topic
            return self._count_unusable(wheel_angles_of(stamp_ns, message, found.joints), topic, stamp_ns)
        return self._count_unusable(out, topic, stamp_ns)

    def _imu(self, stamp_ns: int, message: Any) -> Message | None:
        frame = message.header.frame_id
        if frame not in self._body_R_imu:
            body_T_imu = self._found.tree.find(self._found.body_frame, frame)
            self._body_R_imu[frame] = np.eye(3) if body_T_imu is None else body_T_imu[:3, :3]
        return self._count_unusable(imu_of(stamp_ns, message, self._body_R_imu[frame]), "imu", stamp_ns)

    def _count_unusable(self, message: Message | None, topic: str, stamp_ns: int) -> Message | None:
        if message is None:
            text = f"message of {topic} holds no finite pose, rate or angle: left out"
            self.findings.add(f"unusable-{topic}", text, f"{stamp_ns} ns")
        return message

    def _odometry_transforms(self, message: Any) -> Iterator[Message]:
        """The wheels' pose where the bag has it in /tf only."""
        for stamped in message.transforms:
            edge = (frame_name(stamped.header.frame_id), frame_name(stamped.child_frame_id))
            if edge == self._found.odometry_edge:
                stamp_ns = header_stamp_ns(stamped)
                pose = odometry_of(stamp_ns, stamped.transform.translation, stamped.transform.rotation)
                usable = self._count_unusable(pose, "tf", stamp_ns)
                if usable is not None:
                    yield usable


def _details(reader: BagReader, found: BagSurvey) -> dict[str, Any]:
    return {
        "messages": reader.counts(),
        "scan_source": found.scan_topic,
        "odometry": found.odometry_kind,
        "odometry_source": found.odometry_topic or (found.odometry_edge and " -> ".join(found.odometry_edge)),
        "imu_source": found.imu_topic,
        "wheel_source": found.wheel_topic,
        "body_frame": found.body_frame,
    }
