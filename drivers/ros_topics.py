"""Which topics of a bag are read: by type, and by name where the user says so."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rosbags.interfaces import Connection

from mfslam.types import Findings, MfslamError

SCAN_TYPES = ("sensor_msgs/msg/LaserScan", "sensor_msgs/msg/MultiEchoLaserScan")
ODOMETRY_TYPES = ("nav_msgs/msg/Odometry",)
IMU_TYPES = ("sensor_msgs/msg/Imu",)
JOINT_TYPES = ("sensor_msgs/msg/JointState",)
TRANSFORM_TYPES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")


def of_topic(connections: Sequence[Connection], topic: str | None) -> list[Connection]:
    return [c for c in connections if topic is not None and c.topic == topic]


def choose(
    connections: Sequence[Connection],
    types: tuple[str, ...],
    wanted: str | None,
    path: Path,
    findings: Findings,
    prefer: str = "",
) -> str | None:
    """Name of the topic to read, or None where there is none of these types.

    Without ``wanted``: the one whose last name is ``prefer``, else the one with most messages; the others
    are named in a finding. Raises MfslamError for a wanted topic that is not there.
    """
    counts: dict[str, int] = {}
    for c in connections:
        if c.msgtype in types:
            counts[c.topic] = counts.get(c.topic, 0) + c.msgcount
    kind = types[0].rsplit("/", 1)[-1]
    listed = ", ".join(f"{topic} ({n})" for topic, n in sorted(counts.items())) or "none"
    if wanted is not None:
        match = next((t for t in counts if t.lstrip("/") == wanted.lstrip("/")), None)
        if match is None:
            raise MfslamError(f"{path}: no {kind} topic {wanted!r}; there are: {listed}")
        return match
    heard = {topic: n for topic, n in counts.items() if n > 0}
    if not heard:
        return None
    chosen = min(heard, key=lambda t: (t.rsplit("/", 1)[-1] != prefer, -heard[t], t))
    if len(heard) > 1:
        findings.add(
            f"several-{kind.lower()}",
            f"several {kind} topics: {listed}; {chosen} is used, the others are not",
        )
    return chosen
