"""Reader of the format ``urg-text``: one line per scan of a URG-04LX, with two wheel encoders.

Fields are separated by blanks, counted from 0:

| field | meaning |
| --- | --- |
| 0 | stamp of scan and encoders, microseconds |
| 2, 3 | encoder ticks of the left and of the right wheel since some start |
| 24 ... 705 | 682 ranges, mm, anticlockwise from the right; below 20 an error code of the sensor, 0 none |

Others, and whatever follows field 705, are not used. Each line yields `WheelTicks` and then the `Scan`,
with one stamp.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from drivers.base import LogInfo, NoScans, TopicChoice
from drivers.laser_models import LogGeometry, clean_ranges, laser_from
from drivers.stamp_watch import StampWatch
from drivers.text_source import NumberCache, TextLog, TextSource
from mfslam.config import Config
from mfslam.types import Findings, Message, MfslamError, Scan, WheelTicks

N_BEAMS = 682
FIRST_RANGE = 24
N_FIELDS = FIRST_RANGE + N_BEAMS
_ERROR_CODES_BELOW_MM = 20.0  # SCIP 2.0: smaller values say why there is no range
_MAX_STAMP_US = 2**63 // 1000


class UrgTextLog(TextLog):
    """A ``urg-text`` log: a `drivers.base.Log`. Which wheel is left: ``wheels.swap_sides`` turns it round."""

    def __init__(self, path: Path, config: Config, topics: TopicChoice | None = None) -> None:
        if topics is not None and any((topics.scan, topics.odometry, topics.imu, topics.wheels)):
            raise MfslamError(f"{path}: a urg-text log has one laser and nothing to choose by name")
        self.findings = Findings()
        self.info = LogInfo(path, "urg-text", {"scan_source": "ranges", "odometry": "present"})
        self._source = TextSource(path)
        self._swap = config.wheels.swap_sides
        self._numbers = NumberCache()
        step_rad = 2.0 * math.pi / 1024
        told = LogGeometry(N_BEAMS, angle_min_rad=(44 - 384) * step_rad, angle_step_rad=step_rad)
        self._laser = laser_from(config.sensor, told)

    def __iter__(self) -> Iterator[Message]:
        stamps, n_scans = StampWatch(self.findings), 0
        for line_number, line in self._source.lines():
            fields = line.split()
            if not fields or fields[0].startswith(b"#"):
                continue
            where = self._source.where(line_number)
            try:
                ticks, scan = self._parse(fields, where)
            except ValueError:
                self.findings.add("line-garbled", "line is cut or garbled: left out", where)
                continue
            stamps.see(scan.stamp_ns, where)
            n_scans += 1
            yield ticks
            yield scan
        if self._source.damage:
            self.findings.add("file-damaged", self._source.damage, self._source.path.name)
        self.info.details["messages"] = {"ranges": n_scans}
        if not n_scans:
            raise NoScans(
                f"{self._source.path}: no usable scan in it: no line has {N_FIELDS} readable fields"
            )

    def _parse(self, fields: list[bytes], where: str) -> tuple[WheelTicks, Scan]:
        """Raises ValueError where the line is not what it should be."""
        if len(fields) < N_FIELDS:
            raise ValueError("too few fields")
        stamp_us, left, right = int(fields[0]), int(fields[2]), int(fields[3])
        if not 0 <= stamp_us < _MAX_STAMP_US:
            raise ValueError("stamp out of range")
        ranges_mm = np.array(list(map(self._numbers.__getitem__, fields[FIRST_RANGE:N_FIELDS])), np.float32)
        odd = np.count_nonzero(~(ranges_mm >= 0.0))
        if odd:
            text = "range is negative or not a number: ignored"
            self.findings.add("range-invalid", text, where, int(odd))
        # no return is code 0 or 7, too: nothing can be said of such a beam, not even that it was free
        ranges_mm[ranges_mm < _ERROR_CODES_BELOW_MM] = np.nan
        scan = Scan(stamp_us * 1000, clean_ranges(ranges_mm * np.float32(1e-3), self._laser), self._laser)
        if self._swap:
            left, right = right, left
        return WheelTicks(scan.stamp_ns, left, right), scan
