"""Messages on their way from one process to another: a laser goes once, its scans refer to it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from mfslam.types import Laser, Message, Scan


@dataclass(frozen=True, eq=False)
class Health:
    """`SensorHealth.as_json` of every sensor, and how the recording fares."""

    sensors: list[dict[str, Any]]
    recording_error: str | None = None
    not_forwarded: int = 0


@dataclass(frozen=True, eq=False)
class Ended:
    """The last word: the error that ended it, None for a good end, and the findings as (code, text, where, count)."""

    error: str | None
    findings: list[tuple[str, str, str, int]]


class Packer:
    """Makes scans small."""

    def __init__(self) -> None:
        self._known: dict[int, Laser] = {}

    def pack(self, message: Message) -> list[Any]:
        """What is to be sent for a message."""
        if not isinstance(message, Scan):
            return [message]
        key, out = id(message.laser), []
        if key not in self._known:
            self._known[key] = message.laser  # keeps the laser, and so its id
            out.append((key, message.laser))
        return [*out, (message.stamp_ns, message.ranges_m, key, message.odom_T_body)]


class Unpacker:
    """The inverse of `Packer`."""

    def __init__(self) -> None:
        self._known: dict[int, Laser] = {}

    def unpack(self, item: Any) -> Any:
        """A message, None for what only prepares one; anything else as it is."""
        if not isinstance(item, tuple):
            return item
        if len(item) == 2:
            self._known[item[0]] = item[1]
            return None
        stamp_ns, ranges_m, key, pose = item
        return Scan(stamp_ns, ranges_m, self._known[key], pose)
