"""The CARMEN log format: one message per line, a word and then its fields.

| message | fields |
| --- | --- |
| FLASER, RLASER | n, n ranges, laser pose, odometry pose |
| ROBOTLASER1, 2 | HEAD, laser pose, robot pose, tv, rv, forward and side safety distance, turn axis |
| RAWLASER1 ... 5 | HEAD |
| ODOM | pose, tv, rv, acceleration |
| PARAM | name, value |

HEAD: type, start angle, field of view, resolution, maximum range, accuracy, remission mode, n, n ranges, m,
m remissions. Each ends with the ipc timestamp (s), the host and the logger's timestamp. Metres and radians; poses are
x, y, theta in the odometry frame. The first timestamp is the message's own.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from drivers.laser_models import LogGeometry
from mfslam.types import Findings


@dataclass(frozen=True)
class ScanLayout:
    """Where a scan message keeps what; indices from 0, the word itself included."""

    count_at: int
    remissions: bool
    stamp_at: int  # counted from the first field after readings and remissions
    rear: bool = False

    @property
    def has_poses(self) -> bool:
        return self.stamp_at >= 6

    @property
    def has_geometry(self) -> bool:
        return self.count_at == 8


_ROBOT = ScanLayout(count_at=8, remissions=True, stamp_at=11)
_RAW = ScanLayout(count_at=8, remissions=True, stamp_at=0)

# in order of preference where a log has several: with poses before raw, front before rear
SCANS: dict[bytes, ScanLayout] = {
    b"FLASER": ScanLayout(count_at=1, remissions=False, stamp_at=6),
    b"ROBOTLASER1": _ROBOT,
    b"RAWLASER1": _RAW,
    b"RLASER": ScanLayout(count_at=1, remissions=False, stamp_at=6, rear=True),
    b"ROBOTLASER2": ScanLayout(count_at=8, remissions=True, stamp_at=11, rear=True),
    b"RAWLASER2": ScanLayout(count_at=8, remissions=True, stamp_at=0, rear=True),
    b"RAWLASER3": _RAW,
    b"RAWLASER4": _RAW,
    b"RAWLASER5": _RAW,
}

# messages that are known and hold nothing for mapping
OTHERS = frozenset(
    b"PARAM SYNC TRUEPOS MARKER SONAR BUMPER IMU AXT LASER3 LASER4 VECTORMOVE ROBOTVELOCITY "
    b"FOLLOWTRAJECTORY BASEVELOCITY POSITIONSTAMPED WIFI NMEAGGA NMEARMC NMEA-GGA NMEA-RMC "
    b"GPSGGA GPSRMC BASESONAR BASEBUMPER ARM VISION".split()
)
WORDS = frozenset({*SCANS, *OTHERS, b"ODOM"})


@dataclass(frozen=True, slots=True)
class ScanFields:
    """A scan line taken apart, still as text. ``tail`` starts with the poses, if there are any."""

    readings: list[bytes]
    tail: list[bytes]


def split_scan(fields: list[bytes], layout: ScanLayout) -> ScanFields:
    """Raises ValueError when the number of fields is not what the counts in the line say."""
    start = layout.count_at + 1
    end = start + int(fields[layout.count_at]) if len(fields) > start else 0
    tail_at = end
    if layout.remissions and start < end < len(fields):
        tail_at = end + 1 + int(fields[end])
    tail = len(fields) - tail_at - layout.stamp_at  # stamp, host and, in nearly all logs, the logger's stamp
    if end < start + 2 or tail_at < end or tail not in (2, 3):
        raise ValueError("number of fields is not what the counts in the line say")
    return ScanFields(fields[start:end], fields[tail_at:])


# beams -> bearing of the first, step (degrees), where the format does not tell; SICK leaves out the last
# beam when the number is even
_FIELD_OF_VIEW_DEG: dict[int, tuple[float, float]] = {
    101: (-50.0, 1.0),
    201: (-50.0, 0.5),
    401: (-50.0, 0.25),
    90: (-90.0, 2.0),
    91: (-90.0, 2.0),
    180: (-90.0, 1.0),
    181: (-90.0, 1.0),
    360: (-90.0, 0.5),
    361: (-90.0, 0.5),
    541: (-135.0, 0.5),
    682: (-119.53125, 0.3515625),
    683: (-119.8828125, 0.3515625),
    726: (-119.53125 - 22 * 0.3515625, 0.3515625),
    769: (-135.0, 0.3515625),
    1081: (-135.0, 0.25),
}
_URG_BEAMS, _UTM_BEAMS, _LMS1XX_BEAMS = (682, 683, 726, 769), 1081, 541
_HOKUYO_TYPE = 2  # CARMEN's laser_type of a URG
_SICK_FOV_RAD = math.radians(185.0)


def preset_for(fields: list[bytes], layout: ScanLayout) -> str:
    """Name of the preset that fits a scan line. Raises ValueError for a garbled one."""
    n_beams = int(fields[layout.count_at])
    if n_beams in _URG_BEAMS:
        return "urg-04lx"
    if n_beams == _UTM_BEAMS:
        return "utm-30lx"
    if n_beams == _LMS1XX_BEAMS:
        return "generic"  # half a degree from a mirror of 25 or 50 Hz: which, the log does not say
    if layout.has_geometry:
        if int(fields[1]) == _HOKUYO_TYPE:
            return "urg-04lx"
        if not 0.0 < float(fields[3]) < _SICK_FOV_RAD:
            return "generic"
    return "sick-lms200"


def geometry(
    fields: list[bytes], layout: ScanLayout, n_beams: int, findings: Findings, where: str
) -> LogGeometry:
    """What the line itself, or the number of its beams, says of the laser. No mount."""
    if layout.has_geometry:
        start, fov, step, range_max = (float(f) for f in fields[2:6])
        if not 0.0 < step * (n_beams - 1) < 2.2 * math.pi and n_beams > 1:
            step = fov / (n_beams - 1)
        if math.isfinite(start) and 0.0 < step * (n_beams - 1) < 2.2 * math.pi:
            return LogGeometry(n_beams, start, step, range_max_m=range_max if 0.0 < range_max < 1e3 else None)
        findings.add(
            "geometry-implausible", "start angle or resolution of the laser makes no sense: guessed", where
        )
    if n_beams in _FIELD_OF_VIEW_DEG:
        first_deg, step_deg = _FIELD_OF_VIEW_DEG[n_beams]
        return LogGeometry(n_beams, math.radians(first_deg), math.radians(step_deg))
    findings.add(
        "field-of-view-guessed",
        f"no known laser has {n_beams} beams: 180 deg assumed; set sensor.angle_min_deg and "
        "sensor.angle_step_deg if that is wrong",
        where,
    )
    return LogGeometry(n_beams, -0.5 * math.pi, math.pi / (n_beams - 1))
