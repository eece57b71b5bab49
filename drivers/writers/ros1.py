"""A ROS 1 bag, written by rosbags."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from drivers.writers.ros import RosConverter
from mfslam.config import WheelsConfig
from mfslam.types import Findings, Message


def write_ros1(
    messages: Iterable[Message], path: Path, findings: Findings, wheels: WheelsConfig | None = None
) -> None:
    """One .bag file at ``path``."""
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    tf = "tf2_msgs/msg/TFMessage"  # no store of ROS 1 knows it
    store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms\n", tf))
    converter = RosConverter(dict(store.types), findings, wheels)
    with Writer(path) as bag:
        connections = {}
        for topic, kind, message, bag_ns in converter.convert(messages):
            if topic not in connections:
                latching = 1 if topic == "/tf_static" else None
                connections[topic] = bag.add_connection(topic, kind, typestore=store, latching=latching)
            bag.write(connections[topic], bag_ns, store.serialize_ros1(message, kind))
