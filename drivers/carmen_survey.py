"""A first look through a CARMEN log: what it holds and where the laser sits, before the first scan is read."""

from __future__ import annotations

import math
from array import array
from collections import Counter
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from drivers.base import NoScans
from drivers.carmen_format import SCANS, WORDS, ScanLayout, split_scan
from drivers.text_source import TextSource
from mfslam import se2
from mfslam.types import Findings, FloatArray, MfslamError

_AGREE_M, _AGREE_RAD = 0.05, math.radians(3.0)
_MOVED_M, _MOVED_RAD = 1e-3, 1e-3


@dataclass
class Survey:
    """What a log holds. ``poses``: laser pose and odometry pose of each complete scan line, 6 numbers each."""

    counts: Counter[bytes] = field(default_factory=Counter)
    params: dict[str, str] = field(default_factory=dict)
    poses: dict[bytes, array[float]] = field(default_factory=dict)
    odometry: array[float] = field(default_factory=lambda: array("d"))


def survey(source: TextSource) -> Survey:
    """Reads the whole log once, parsing only the poses. Garbled lines are passed over here; the reader
    proper counts them."""
    found = Survey(poses={word: array("d") for word in SCANS})
    for _, line in source.lines():
        fields = line.split()
        if not fields or fields[0] not in WORDS:
            continue
        word = fields[0]
        found.counts[word] += 1
        layout = SCANS.get(word)
        try:
            if layout is not None and layout.has_poses:
                tail = split_scan(fields, layout).tail
                found.poses[word].extend([float(f) for f in tail[:6]])
            elif word == b"ODOM":
                found.odometry.extend([float(f) for f in fields[1:4]])
            elif word == b"PARAM" and len(fields) >= 3:
                found.params[fields[1].decode("utf-8", "replace")] = fields[2].decode("utf-8", "replace")
        except ValueError:
            continue
    return found


def choose_source(found: Survey, wanted: str | None, findings: Findings, path: str) -> bytes:
    """The scan message to read: the one asked for, else the front laser unless it hardly speaks."""
    present = [word for word in SCANS if found.counts[word]]
    names = ", ".join(f"{word.decode()} ({found.counts[word]})" for word in present)
    if wanted is not None:
        if wanted.upper().encode() in present:
            return wanted.upper().encode()
        raise MfslamError(f"{path}: no scans named {wanted!r} in it; there are: {names or 'none at all'}")
    if not present:
        held = (
            ", ".join(f"{word.decode()} ({n})" for word, n in found.counts.most_common()) or "nothing known"
        )
        raise NoScans(
            f"{path}: no scans in it (expected FLASER, RLASER, ROBOTLASER1 or RAWLASER1 lines; it holds {held})"
        )
    most = max(found.counts[word] for word in present)
    chosen = next(word for word in present if 2 * found.counts[word] >= most)
    if len(present) > 1:
        findings.add(
            "several-lasers",
            f"scans of several names: {names}; {chosen.decode()} is used, the others are not",
        )
    return chosen


def odometry_kind(found: Survey, word: bytes) -> Literal["moving", "constant", "none"]:
    """Whether the log's odometry says anything."""
    in_scans = np.frombuffer(found.poses.get(word, array("d")), dtype=np.float64).reshape(-1, 6)[:, 3:]
    lines = np.frombuffer(found.odometry, dtype=np.float64)
    in_lines = lines[: lines.size // 3 * 3].reshape(-1, 3)
    parts = [poses[np.isfinite(poses).all(axis=1)] for poses in (in_scans, in_lines)]
    if not any(len(p) for p in parts):
        return "none"
    moved = any(
        len(p) > 0 and (np.ptp(p[:, :2], axis=0).max() > _MOVED_M or np.ptp(p[:, 2]) > _MOVED_RAD)
        for p in parts
    )
    return "moving" if moved else "constant"


def mount_of(found: Survey, word: bytes, findings: Findings) -> tuple[float, float, float] | None:
    """body_T_laser from the log: median of (laser pose seen from the odometry pose) over the lines, else
    from PARAM. None where the log does not tell."""
    layout = SCANS[word]
    rows = np.frombuffer(found.poses.get(word, array("d")), dtype=np.float64).reshape(-1, 6)
    rows = rows[np.isfinite(rows).all(axis=1)]
    from_param = _mount_from_params(found.params, layout)
    if not len(rows):
        return from_param
    seen = se2.between(rows[:, 3:], rows[:, :3])
    median = _median_pose(seen)
    off = se2.between(median, seen)
    agree = (np.hypot(off[:, 0], off[:, 1]) < _AGREE_M) & (np.abs(off[:, 2]) < _AGREE_RAD)
    if np.mean(agree) >= 0.9:
        x, y, yaw = median
        return float(x), float(y), float(yaw)
    findings.add(
        "mount-unclear",
        "laser poses do not keep a fixed distance to the odometry poses (a corrected log?): the laser's mount "
        + ("is taken from PARAM" if from_param else "is taken as zero; set sensor.mount_x_m if it is not"),
        count=int(np.count_nonzero(~agree)),
    )
    return from_param


def _median_pose(poses: FloatArray) -> FloatArray:
    mean_yaw = math.atan2(np.median(np.sin(poses[:, 2])), np.median(np.cos(poses[:, 2])))
    yaw = mean_yaw + np.median(se2.wrap(poses[:, 2] - mean_yaw))
    return np.array([np.median(poses[:, 0]), np.median(poses[:, 1]), float(se2.wrap(yaw))])


def _mount_from_params(params: dict[str, str], layout: ScanLayout) -> tuple[float, float, float] | None:
    """robot_frontlaser_offset and its kin; a rear laser looks backwards unless PARAM says otherwise."""
    prefix = "robot_rearlaser_" if layout.rear else "robot_frontlaser_"
    x, y, yaw = (number(params, prefix + k) for k in ("offset", "side_offset", "angular_offset"))
    if x is None and y is None and yaw is None:
        return (0.0, 0.0, math.pi) if layout.rear else None
    return x or 0.0, y or 0.0, yaw if yaw is not None else (math.pi if layout.rear else 0.0)


def number(params: dict[str, str], name: str) -> float | None:
    """A PARAM's finite value, or None."""
    try:
        value = float(params.get(name, ""))
    except ValueError:
        return None
    return value if math.isfinite(value) else None
