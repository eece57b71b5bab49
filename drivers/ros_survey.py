"""A first look into a ROS bag: which topics to read, where the laser sits, how fast it turns."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import islice
from typing import Any

import numpy as np
from rosbags.interfaces import Connection

from drivers import ros_topics
from drivers.base import NoScans, TopicChoice
from drivers.beam_timing import ScanTiming, turn_period_s, usual_gap_s
from drivers.ros_messages import header_stamp_ns, step_rad, wheel_joints
from drivers.ros_reader import BagReader
from drivers.ros_transforms import TransformTree, frame_name
from mfslam.config import Config
from mfslam.types import Findings

_SCANS_LOOKED_AT = 300
_TRANSFORMS_LOOKED_AT = 2000
_JOINTS_LOOKED_AT = 50
_BODY_FRAMES = ("base_link", "base_footprint", "base", "robot_base", "base_frame")


@dataclass
class BagSurvey:
    """What was found out before the first message is read."""

    scan_topic: str
    odometry_topic: str | None = None
    imu_topic: str | None = None
    wheel_topic: str | None = None
    joints: tuple[str, str] | None = None
    transform_topics: set[str] = field(default_factory=set)  # read for odometry only
    odometry_edge: tuple[str, str] | None = None
    body_frame: str = _BODY_FRAMES[0]
    turn_period_s: float | None = None
    tree: TransformTree = field(default_factory=TransformTree)
    connections: list[Connection] = field(default_factory=list)

    @property
    def odometry_kind(self) -> str:
        some = self.odometry_topic or self.odometry_edge or self.wheel_topic
        return "present" if some else "none"


def survey(reader: BagReader, config: Config, topics: TopicChoice, findings: Findings) -> BagSurvey:
    """Raises NoScans, and MfslamError for a topic that was named and is not there."""
    path, connections = reader.path, reader.connections
    scan_topic = ros_topics.choose(connections, ros_topics.SCAN_TYPES, topics.scan, path, findings)
    if scan_topic is None:
        held = ", ".join(f"{topic} ({n})" for topic, n in reader.counts().items()) or "no message at all"
        raise NoScans(f"{path}: no scans in it (no LaserScan or MultiEchoLaserScan topic); it holds {held}")
    found = BagSurvey(scan_topic)
    found.odometry_topic = ros_topics.choose(
        connections, ros_topics.ODOMETRY_TYPES, topics.odometry, path, findings, prefer="odom"
    )
    found.imu_topic = ros_topics.choose(connections, ros_topics.IMU_TYPES, topics.imu, path, findings)
    _find_wheels(reader, found, config, topics, findings)
    _find_body(reader, found, config, findings)
    if found.odometry_kind == "none":
        findings.add("no-odometry", "the bag has no odometry: motion comes from the scans")
    chosen = (found.scan_topic, found.odometry_topic, found.imu_topic, found.wheel_topic)
    read = {topic for topic in chosen if topic} | found.transform_topics
    found.connections = [c for c in connections if c.topic in read]
    return found


def _find_wheels(
    reader: BagReader, found: BagSurvey, config: Config, topics: TopicChoice, findings: Findings
) -> None:
    """Wheel joints are read where they are asked for, or nothing better is there."""
    topic = ros_topics.choose(
        reader.connections,
        ros_topics.JOINT_TYPES,
        topics.wheels,
        reader.path,
        findings,
        prefer="joint_states",
    )
    names: list[str] = []
    for message in _first(reader, topic, _JOINTS_LOOKED_AT):
        names += [name for name in message.name if name not in names]
    joints = wheel_joints(names, config.wheels)
    if topic is None:
        return
    if joints is None:
        asked = topics.wheels or config.wheels.left_joint or config.wheels.right_joint
        if asked or not found.odometry_topic:
            findings.add(
                "no-wheel-joints",
                f"{topic} has no joints known as left and right wheel (it has {', '.join(names) or 'none'}): not "
                "used; set wheels.left_joint and wheels.right_joint",
            )
    elif found.odometry_topic and not topics.wheels:
        findings.add(
            "wheel-joints-unused", f"{topic} has wheels, too: not used, since {found.odometry_topic} is there"
        )
    else:
        found.wheel_topic, found.joints = topic, joints


def _find_body(reader: BagReader, found: BagSurvey, config: Config, findings: Findings) -> None:
    """Beam timing, the body's frame and the laser's mount."""
    scans = list(_first(reader, found.scan_topic, _SCANS_LOOKED_AT))
    if config.sensor.turn_period_s is None and scans:
        timing = ScanTiming(
            n_beams=int(np.median([len(s.ranges) for s in scans])),
            angle_step_rad=float(np.median([step_rad(s) for s in scans])),
            time_increment_s=float(np.median([s.time_increment for s in scans])),
            scan_time_s=float(np.median([s.scan_time for s in scans])),
            gap_s=usual_gap_s([header_stamp_ns(s) for s in scans]) or _bag_gap_s(reader, found.scan_topic),
        )
        found.turn_period_s = turn_period_s(timing, findings)
    laser_frame = frame_name(scans[0].header.frame_id) if scans else ""
    bodies = [frame_name(m.child_frame_id) for m in _first(reader, found.odometry_topic, 1)]
    candidates = [body for body in bodies if body] + list(_BODY_FRAMES)
    transforms = [c for c in reader.connections if c.msgtype in ros_topics.TRANSFORM_TYPES]
    static = [c for c in transforms if c.topic.endswith("tf_static")]
    for _, _, message in reader.messages(static):
        found.tree.add(message)
    dynamic = [c for c in transforms if c not in static]
    for _, _, message in islice(reader.messages(dynamic), _TRANSFORMS_LOOKED_AT):
        found.tree.add(message)
    body = next((b for b in candidates if found.tree.find(b, laser_frame) is not None), None)
    if body is not None:
        found.body_frame = body
    elif config.sensor.mount_x_m is None:
        findings.add(
            "mount-unknown",
            f"no fixed transform from {candidates[0]} to {laser_frame or 'the laser'} in the bag: the laser's mount "
            "is taken as zero; set sensor.mount_x_m, mount_y_m and mount_yaw_deg",
        )
    if not (found.odometry_topic or found.wheel_topic):
        edges = [e for e in found.tree.moving if "odom" in e[0] and "map" not in e[0]]
        found.odometry_edge = next((e for e in edges if e[1] in candidates), None)
        if found.odometry_edge:
            found.transform_topics = {c.topic for c in dynamic}


def _bag_gap_s(reader: BagReader, topic: str) -> float | None:
    """Pace of the scans by the time of recording, where their stamps do not tell."""
    scans = reader.messages(ros_topics.of_topic(reader.connections, topic))
    return usual_gap_s([time_ns for _, time_ns, _ in islice(scans, _SCANS_LOOKED_AT)])


def _first(reader: BagReader, topic: str | None, count: int) -> Iterator[Any]:
    messages = reader.messages(ros_topics.of_topic(reader.connections, topic))
    return (message for _, _, message in islice(messages, count))
