"""What a log holds and what is odd in it: the substance of ``mfslam info``."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from drivers.base import LogInfo, TopicChoice
from drivers.logs import open_log
from mfslam import se2
from mfslam.config import Config
from mfslam.types import Findings, FloatArray, Imu, Laser, Message, Odometry, Scan, WheelAngles, WheelTicks

_SOURCES = {
    "scans": "the poses that come with the scans",
    "poses": "odometry messages",
    "wheels": "the wheels as configured",
}
_BURST_SHARE = 0.2  # a gap under this share of the median one is a burst


@dataclass
class LaserUse:
    """How one laser geometry was used in a log."""

    laser: Laser
    scans: int = 0
    beams: int = 0
    no_return: int = 0
    invalid: int = 0

    def add(self, scan: Scan) -> None:
        self.scans += 1
        self.beams += scan.ranges_m.size
        self.no_return += int(np.count_nonzero(np.isposinf(scan.ranges_m)))
        self.invalid += int(np.count_nonzero(np.isnan(scan.ranges_m)))

    def as_json(self) -> dict[str, Any]:
        laser = self.laser
        x, y, yaw = (float(v) for v in laser.body_T_laser)
        return {
            "name": laser.name,
            "scans": self.scans,
            "beams": laser.angles_rad.size,
            "first_beam_deg": math.degrees(laser.angles_rad[0]),
            "last_beam_deg": math.degrees(laser.angles_rad[-1]),
            "scan_duration_s": float(np.ptp(laser.offsets_s)),
            "range_min_m": laser.range_min_m,
            "range_max_m": laser.range_max_m,
            "mount": {"x_m": x, "y_m": y, "yaw_deg": math.degrees(yaw)},
            "no_return_share": self.no_return / self.beams,
            "invalid_share": self.invalid / self.beams,
        }


@dataclass
class LogDescription:
    """A log in figures. ``stamps`` speaks of the scans' stamps, ``odometry`` of the poses that came along."""

    info: LogInfo
    counts: dict[str, int] = field(default_factory=dict)
    lasers: list[LaserUse] = field(default_factory=list)
    stamps: dict[str, Any] = field(default_factory=dict)
    odometry: dict[str, Any] = field(default_factory=dict)
    findings: Findings = field(default_factory=Findings)

    def as_json(self) -> dict[str, Any]:
        return {
            "path": str(self.info.path),
            "format": self.info.format,
            "details": self.info.details,
            "messages": self.counts,
            "lasers": [use.as_json() for use in self.lasers],
            "stamps": self.stamps,
            "odometry": self.odometry,
            "findings": self.findings.as_json(),
        }

    def text(self) -> str:
        """For people, one fact a line."""
        lines = [f"{self.info.path}: {self.info.format}"]
        for name, count in self.info.details.get("messages", {}).items():
            mark = "  (scans are read from here)" if name == self.info.details.get("scan_source") else ""
            lines.append(f"  holds     {count} x {name}{mark}")
        lines.append("  read as   " + ", ".join(f"{n} {name}" for name, n in self.counts.items()))
        lines += [_laser_text(use.as_json()) for use in self.lasers]
        lines.append(_stamps_text(self.stamps))
        lines.append(_odometry_text(self.odometry))
        lines += [f"  odd       {line}" for line in self.findings.lines()] or ["  odd       nothing"]
        return "\n".join(lines)


def describe_log(path: Path | str, config: Config, topics: TopicChoice | None = None) -> LogDescription:
    """Read a whole log and say what is in it. Raises MfslamError as `open_log` and its iteration do."""
    stamps_ns: list[int] = []
    poses = _PoseTrack(config)
    uses: dict[int, LaserUse] = {}
    counts: dict[str, int] = {}
    with open_log(path, config, topics=topics) as log:
        description = LogDescription(log.info, counts, findings=log.findings)
        for message in log:
            kind = type(message).__name__
            counts[kind] = counts.get(kind, 0) + 1
            poses.add(message)
            if isinstance(message, Scan):
                stamps_ns.append(message.stamp_ns)
                uses.setdefault(id(message.laser), LaserUse(message.laser)).add(message)
    description.lasers = sorted(uses.values(), key=lambda use: -use.scans)
    description.stamps = _stamp_facts(stamps_ns)
    description.odometry = poses.facts()
    return description


def _stamp_facts(stamps_ns: list[int]) -> dict[str, Any]:
    """Gaps between the stamps of consecutive scans, in log order."""
    stamps = np.asarray(stamps_ns, dtype=np.int64)
    gaps_s = np.diff(stamps) * 1e-9
    forward = gaps_s[gaps_s > 0]
    median = float(np.median(forward)) if forward.size else 0.0
    return {
        "first_ns": int(stamps[0]),
        "last_ns": int(stamps[-1]),
        "duration_s": float(np.ptp(stamps)) * 1e-9,
        "median_gap_s": median,
        "largest_gap_s": float(forward.max()) if forward.size else 0.0,
        "rate_hz": 1.0 / median if median else 0.0,
        "backwards": int(np.count_nonzero(gaps_s < 0)),
        "repeated": int(np.count_nonzero(gaps_s == 0)),
        "bursts": int(np.count_nonzero(forward < _BURST_SHARE * median)),
    }


class _PoseTrack:
    """Steps of the wheels: poses that come with the scans where there are any, else poses alone, else ticks
    or angles by the configured wheels."""

    def __init__(self, config: Config) -> None:
        self._limits, self._wheels = config.odometry, config.wheels
        self._rows: dict[str, list[tuple[int, FloatArray]]] = {"scans": [], "poses": [], "wheels": []}
        self._gyro: list[tuple[int, float]] = []

    def add(self, message: Message) -> None:
        if isinstance(message, Scan) and message.odom_T_body is not None:
            self._rows["scans"].append((message.stamp_ns, message.odom_T_body))
        elif isinstance(message, Odometry):
            self._rows["poses"].append((message.stamp_ns, message.odom_T_body))
        elif isinstance(message, WheelTicks):
            turns = np.array([message.left, message.right]) / self._wheels.ticks_per_turn
            self._rows["wheels"].append((message.stamp_ns, turns * 2.0 * np.pi))
        elif isinstance(message, WheelAngles):
            angles = np.array([message.left_rad, message.right_rad])
            self._rows["wheels"].append((message.stamp_ns, angles))
        elif isinstance(message, Imu) and message.yaw_rate_rad_s is not None:
            self._gyro.append((message.stamp_ns, message.yaw_rate_rad_s))

    def facts(self) -> dict[str, Any]:
        source = next((name for name, rows in self._rows.items() if len(rows) >= 2), "none")
        out: dict[str, Any] = {"source": source}
        if source != "none":
            stamps_ns, values = (np.array(column) for column in zip(*self._rows[source], strict=True))
            steps = self._wheel_steps(values) if source == "wheels" else se2.between(values[:-1], values[1:])
            lengths, turns = np.hypot(steps[:, 0], steps[:, 1]), np.abs(steps[:, 2])
            gaps_s = np.diff(stamps_ns) * 1e-9
            # stamps may lie: a step is allowed at least what the median gap allows
            allowed_s = np.maximum(gaps_s, np.median(np.abs(gaps_s)))
            jumps = lengths > self._limits.max_speed_m_s * allowed_s
            jumps |= turns > self._limits.max_yaw_rate_rad_s * allowed_s
            out |= {
                "distance_m": float(lengths[~jumps].sum()),
                "turned_deg": math.degrees(float(turns[~jumps].sum())),
                "jumps": int(np.count_nonzero(jumps)),
            }
        if len(self._gyro) >= 2:
            stamps_ns, rates = (np.array(column) for column in zip(*self._gyro, strict=True))
            net_rad = float(np.sum(np.diff(stamps_ns) * 1e-9 * rates[1:]))
            out["gyro_net_turn_deg"] = math.degrees(net_rad)
        return out

    def _wheel_steps(self, angles_rad: FloatArray) -> FloatArray:
        """Arc length and turn (eqs. 7-11); the turn is not wrapped, so that a jump shows."""
        radii = np.array([self._wheels.radius_left_m, self._wheels.radius_right_m])
        left, right = (np.diff(angles_rad, axis=0) * radii).T
        turn = (right - left) / self._wheels.track_m
        return np.stack([0.5 * (left + right), np.zeros_like(turn), turn], axis=-1)


def _laser_text(laser: dict[str, Any]) -> str:
    mount = laser["mount"]
    return (
        f"  laser     {laser['name']}: {laser['scans']} scans of {laser['beams']} beams, "
        f"{laser['first_beam_deg']:.2f} to {laser['last_beam_deg']:.2f} deg, "
        f"{laser['scan_duration_s'] * 1e3:.1f} ms from first to last beam, "
        f"{laser['range_min_m']:g} to {laser['range_max_m']:g} m, "
        f"mounted at x {mount['x_m']:.3f} m, y {mount['y_m']:.3f} m, {mount['yaw_deg']:.2f} deg; "
        f"no return {laser['no_return_share']:.1%}, invalid {laser['invalid_share']:.1%} of the beams"
    )


def _stamps_text(stamps: dict[str, Any]) -> str:
    return (
        f"  stamps    {stamps['duration_s']:.1f} s, {stamps['rate_hz']:.2f} Hz (median gap "
        f"{stamps['median_gap_s'] * 1e3:.1f} ms, largest {stamps['largest_gap_s']:.2f} s), "
        f"{stamps['backwards']} backwards, {stamps['repeated']} repeated, {stamps['bursts']} in bursts"
    )


def _odometry_text(odometry: dict[str, Any]) -> str:
    gyro = f"; gyro: {odometry['gyro_net_turn_deg']:.0f} deg net" if "gyro_net_turn_deg" in odometry else ""
    if "distance_m" not in odometry:
        return "  odometry  none" + gyro
    return (
        f"  odometry  {odometry['distance_m']:.1f} m and {odometry['turned_deg']:.0f} deg in all, "
        f"{odometry['jumps']} jumps, by {_SOURCES[odometry['source']]}" + gyro
    )
