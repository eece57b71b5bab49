"""Reader of CARMEN logs (`drivers.carmen_format`), plain or compressed."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from drivers.base import LogInfo, NoScans, TopicChoice
from drivers.carmen_format import SCANS, WORDS, geometry, split_scan
from drivers.carmen_survey import choose_source, mount_of, number, odometry_kind, survey
from drivers.laser_models import clean_ranges, laser_from
from drivers.stamp_watch import StampWatch
from drivers.text_source import NumberCache, TextLog, TextSource, stamp_ns
from mfslam.config import Config
from mfslam.types import Findings, FloatArray, Laser, Message, MfslamError, Odometry, Scan


class CarmenLog(TextLog):
    """A CARMEN log: a `drivers.base.Log`. Opening it looks through the whole file once.

    Raises MfslamError where it cannot be read, NoScans where it holds no scans.
    """

    def __init__(self, path: Path, config: Config, topics: TopicChoice | None = None) -> None:
        if topics is not None and any((topics.odometry, topics.imu, topics.wheels)):
            raise MfslamError(
                f"{path}: in a CARMEN log only a scan's name can be chosen (FLASER, RLASER, ...)"
            )
        self.findings = Findings()
        self._sensor = config.sensor
        self._source = TextSource(path)
        found = survey(self._source)
        self._word = choose_source(found, topics.scan if topics else None, self.findings, str(path))
        self._layout = SCANS[self._word]
        self._mount = mount_of(found, self._word, self.findings)
        side = "rear" if self._layout.rear else "front"
        self._range_max_m = number(found.params, f"robot_{side}_laser_max")
        self._lasers: dict[tuple[bytes, ...], Laser] = {}
        self._latest: Laser | None = None
        self._numbers = NumberCache()
        odometry = odometry_kind(found, self._word)
        if odometry != "moving":
            self.findings.add("no-odometry", f"the log's odometry is {odometry}: motion comes from the scans")
        self.info = LogInfo(
            path,
            "carmen",
            {
                "messages": {word.decode(): count for word, count in sorted(found.counts.items())},
                "scan_source": self._word.decode(),
                "odometry": odometry,
            },
        )

    def __iter__(self) -> Iterator[Message]:
        stamps, n_scans = StampWatch(self.findings), 0
        for line_number, line in self._source.lines():
            fields = line.split()
            if not fields or fields[0].startswith(b"#"):
                continue
            try:
                if fields[0] == self._word:
                    scan = self._scan(fields, line_number)
                    stamps.see(scan.stamp_ns, self._source.where(line_number))
                    n_scans += 1
                    yield scan
                elif fields[0] == b"ODOM":
                    yield _odometry(fields)
                elif fields[0] not in WORDS:
                    self._count("unknown-line", "line starts with no CARMEN message: left out", line_number)
            except ValueError:
                self._count("line-garbled", "line is cut or garbled: left out", line_number)
        if self._source.damage:
            self.findings.add("file-damaged", self._source.damage, self._source.path.name)
        if not n_scans:
            raise NoScans(
                f"{self._source.path}: no usable scan in it: none of its {self._word.decode()} lines is complete"
            )

    def _scan(self, fields: list[bytes], line_number: int) -> Scan:
        """Raises ValueError where the line is not what it should be."""
        parts = split_scan(fields, self._layout)
        stamp = stamp_ns(parts.tail[self._layout.stamp_at])
        readings = map(self._numbers.__getitem__, parts.readings)
        ranges = np.fromiter(readings, np.float32, len(parts.readings))
        laser = self._laser(fields, len(ranges), line_number)
        odd = np.count_nonzero(~(ranges >= 0.0))
        if odd:
            self._count("range-invalid", "range is negative or not a number: ignored", line_number, int(odd))
        return Scan(stamp, clean_ranges(ranges, laser), laser, self._pose_of(parts.tail, line_number))

    def _pose_of(self, tail: list[bytes], line_number: int) -> FloatArray | None:
        if not self._layout.has_poses:
            return None
        x, y, theta = float(tail[3]), float(tail[4]), float(tail[5])
        if math.isfinite(x + y + theta):
            return np.array([x, y, theta])
        self._count("odometry-invalid", "odometry pose is not a number: ignored", line_number)
        return None

    def _laser(self, fields: list[bytes], n_beams: int, line_number: int) -> Laser:
        header = fields[2:6] if self._layout.has_geometry else []
        key = (fields[self._layout.count_at], *header)
        laser = self._lasers.get(key)
        if laser is None:
            laser = self._lasers[key] = self._new_laser(fields, n_beams, line_number)
        if self._latest is not None and laser is not self._latest:
            text = f"the laser's number of beams or geometry changes, here to {n_beams} beams: followed"
            self._count("laser-changed", text, line_number)
        self._latest = laser
        return laser

    def _new_laser(self, fields: list[bytes], n_beams: int, line_number: int) -> Laser:
        told = geometry(fields, self._layout, n_beams, self.findings, self._source.where(line_number))
        if self._sensor.turn_period_s is None:
            text = (
                "CARMEN does not tell how fast the laser turns: each scan is taken as a snapshot; "
                "set sensor.turn_period_s or choose a preset"
            )
            self._count("turn-period-unknown", text, line_number)
        limits = [m for m in (told.range_max_m, self._range_max_m) if m is not None and m > 0.0]
        told = replace(told, range_max_m=min(limits, default=None), body_T_laser=self._mount)
        return laser_from(self._sensor, told, name=self._word.decode().lower())

    def _count(self, code: str, text: str, line_number: int, count: int = 1) -> None:
        self.findings.add(code, text, self._source.where(line_number), count)


def _odometry(fields: list[bytes]) -> Odometry:
    """ODOM x y theta tv rv accel stamp host [logger's stamp]."""
    if len(fields) not in (9, 10):
        raise ValueError("number of fields")
    x, y, theta = float(fields[1]), float(fields[2]), float(fields[3])
    if not math.isfinite(x + y + theta):
        raise ValueError("pose is not a number")
    return Odometry(stamp_ns(fields[7]), np.array([x, y, theta]))
