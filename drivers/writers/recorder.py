"""A recording that survives whatever ends it: MCAP with ROS 2 messages, brought to disk chunk by chunk.

Written by `mcap`, whose writer can close a chunk when told to (rosbags' closes one per MB of messages and
gives its chunks no checksum); the messages are serialised by rosbags, as in all bags that mfslam writes.
"""

from __future__ import annotations

import os
import time
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from drivers.laser_models import as_told
from drivers.writers.ros import RosConverter, RosMessage
from mfslam.config import Config
from mfslam.types import Findings, Laser, Message, MfslamError, Scan

CHUNK_S = 0.5
# for tf2's static listeners: what is said once is kept for those who come later
_LATCHED = (
    "- history: 1\n  depth: 1\n  reliability: 1\n  durability: 1\n  deadline: {sec: 9223372036, nsec: 854775807}\n"
    "  lifespan: {sec: 9223372036, nsec: 854775807}\n  liveliness: 1\n"
    "  liveliness_lease_duration: {sec: 9223372036, nsec: 854775807}\n  avoid_ros_namespace_conventions: false\n"
)


class Recorder:
    """An open recording; a context manager. Raises MfslamError for a file that exists or cannot be written.

    Whatever was `add`-ed before the latest `sync` survives a power cut. ``notes`` go into the file as MCAP
    metadata. ``config``: under which the messages came; scans are recorded as the sensor tells them (`as_told`).
    """

    def __init__(self, path: Path, config: Config | None = None, notes: dict[str, str] | None = None) -> None:
        from mcap.writer import CompressionType, Writer
        from rosbags.typesys import Stores, get_typestore

        self.path = path
        self.messages = 0
        self.findings = Findings()
        self._store = get_typestore(Stores.ROS2_HUMBLE)
        self._channels: dict[str, int] = {}
        self._config = config or Config()
        # by id: as it comes, which keeps the id; as it is told
        self._lasers: dict[int, tuple[Laser, Laser]] = {}
        self._converter = RosConverter(
            dict(self._store.types), self.findings, self._config.wheels, self._config.sensor.upside_down
        )
        self._synced_s = time.monotonic()
        self._disk = _Disk(path)
        try:
            self._mcap = Writer(self._disk, compression=CompressionType.ZSTD)
            self._mcap.start(profile="ros2", library="mfslam")
            if notes:
                self._mcap.add_metadata("mfslam", notes)
            self.sync()
        except OSError as error:
            raise self._failed(error) from None

    @property
    def size_bytes(self) -> int:
        return self._disk.safe_bytes

    def add(self, message: Message) -> None:
        """Take a message; raises MfslamError when the disk is full."""
        if isinstance(message, Scan):
            message = replace(message, laser=self._as_told(message.laser))
        for ros in self._converter.convert([message]):
            self._write(ros)
        self.messages += 1
        self.tick()

    def _as_told(self, laser: Laser) -> Laser:
        if id(laser) not in self._lasers:
            self._lasers[id(laser)] = laser, as_told(laser, self._config.sensor)
        return self._lasers[id(laser)][1]

    def tick(self) -> None:
        """To be called often, also when nothing comes: a chunk is at most ``CHUNK_S`` old."""
        if time.monotonic() - self._synced_s >= CHUNK_S:
            self.sync()

    def sync(self) -> None:
        """Bring everything to disk."""
        try:
            self._mcap.flush()
            self._disk.sync()
        except OSError as error:
            raise self._failed(error) from None
        self._synced_s = time.monotonic()

    def close(self) -> None:
        """Write the index, so that any tool opens it at once. A recording that failed is left as it is."""
        if self._disk.closed:
            return
        try:
            self._mcap.finish()
            self._disk.flush()
            self._disk.sync()
        except OSError as error:
            raise self._failed(error) from None
        finally:
            self._disk.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _write(self, ros: RosMessage) -> None:
        topic, kind, message, time_ns = ros
        if topic not in self._channels:
            self._channels[topic] = self._new_channel(topic, kind)
        data = bytes(self._store.serialize_cdr(message, kind))
        self._mcap.add_message(self._channels[topic], time_ns, data, time_ns)

    def _new_channel(self, topic: str, kind: str) -> int:
        definition, _ = self._store.generate_msgdef(kind, ros_version=2)
        schema = self._mcap.register_schema(kind, "ros2msg", definition.encode())
        profiles = _LATCHED if topic == "/tf_static" else ""
        return int(self._mcap.register_channel(topic, "cdr", schema, {"offered_qos_profiles": profiles}))

    def _failed(self, error: OSError) -> MfslamError:
        kept = self._disk.safe_bytes
        self._disk.close()
        reason = (error.strerror or str(error)).lower()
        return MfslamError(
            f"{self.path}: recording stopped: {reason}; what was recorded until then is kept ({kept} bytes) and can be "
            "mapped"
        )


class _Disk:
    """A new file that grows by whole pieces: what was written since the last `flush` is in it whole or not at
    all."""

    def __init__(self, path: Path) -> None:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file: Any = path.open("xb", buffering=0)
        except FileExistsError:
            raise MfslamError(
                f"{path}: exists already; a recording never replaces one: choose another name"
            ) from None
        except OSError as error:
            raise MfslamError(f"{path}: cannot be written: {(error.strerror or '').lower()}") from None
        self.safe_bytes = 0
        self._waiting = bytearray()
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)  # the name, too, must survive
        finally:
            os.close(folder)

    @property
    def closed(self) -> bool:
        return bool(self._file.closed)

    def write(self, data: bytes) -> int:
        self._waiting += data
        return len(data)

    def tell(self) -> int:
        return self.safe_bytes + len(self._waiting)

    def flush(self) -> None:
        data, self._waiting = bytes(self._waiting), bytearray()
        done = 0
        try:
            while done < len(data):
                done += self._file.write(data[done:])
        except OSError:
            self._file.truncate(self.safe_bytes)
            raise
        self.safe_bytes += len(data)

    def sync(self) -> None:
        os.fsync(self._file.fileno())

    def close(self) -> None:
        self._file.close()
