"""A ROS 2 bag, sqlite3 or MCAP, written by rosbags."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Literal

from drivers.writers.ros import RosConverter
from mfslam.config import WheelsConfig
from mfslam.types import Findings, Message


def write_ros2(
    messages: Iterable[Message],
    path: Path,
    findings: Findings,
    storage: Literal["sqlite3", "mcap"],
    wheels: WheelsConfig | None = None,
) -> None:
    """A bag folder at ``path``: metadata.yaml and one storage file."""
    from rosbags.interfaces import (
        Qos,
        QosDurability,
        QosHistory,
        QosLiveliness,
        QosReliability,
        QosTime,
    )
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    converter = RosConverter(dict(store.types), findings, wheels)
    plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
    for_ever = QosTime(9223372036, 854775807)
    latched = Qos(  # what tf2's static listeners ask for when the bag is played
        QosHistory.KEEP_LAST,
        1,
        QosReliability.RELIABLE,
        QosDurability.TRANSIENT_LOCAL,
        for_ever,
        for_ever,
        QosLiveliness.AUTOMATIC,
        for_ever,
        avoid_ros_namespace_conventions=False,
    )
    with Writer(path, version=8, storage_plugin=plugin) as bag:
        connections = {}
        for topic, kind, message, bag_ns in converter.convert(messages):
            if topic not in connections:
                profiles = (latched,) if topic == "/tf_static" else ()
                connections[topic] = bag.add_connection(
                    topic, kind, typestore=store, offered_qos_profiles=profiles
                )
            bag.write(connections[topic], bag_ns, store.serialize_cdr(message, kind))
