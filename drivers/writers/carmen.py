"""CARMEN text logs: FLASER and RLASER for SICK geometry, ROBOTLASER1 for any other; ODOM; PARAM.

Not held by the format: beam timing and the gyro. Beams without return are written as 81.91 m (or just
beyond the laser's maximum), invalid ones as 0.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import IO

import numpy as np

from drivers.writers.text import even_step_rad, seconds
from mfslam import se2
from mfslam.types import Findings, FloatArray, Imu, Laser, Message, MfslamError, Odometry, Scan

_HOST = "mfslam"
_NO_RETURN_M = 81.91  # what a SICK says in its 80 m mode
_SICK_STEPS_DEG = {180: 1.0, 181: 1.0, 360: 0.5, 361: 0.5}


def write_carmen(messages: Iterable[Message], out: IO[str], findings: Findings) -> None:
    """Scans carry their own odometry pose, else the latest one before them, else zeros (counted)."""
    out.write(
        "# CARMEN log: one message per line, each ends with ipc_timestamp ipc_hostname logger_timestamp\n"
    )
    first_ns: int | None = None
    odom_T_body: FloatArray | None = None
    told: set[int] = set()
    for message in messages:
        first_ns = message.stamp_ns if first_ns is None else first_ns
        tail = f"{seconds(message.stamp_ns)} {_HOST} {seconds(message.stamp_ns - first_ns)}\n"
        if isinstance(message, Scan):
            pose = message.odom_T_body if message.odom_T_body is not None else odom_T_body
            if pose is None:
                pose = np.zeros(3)
                findings.add(
                    "no-odometry",
                    "scans before any odometry were written at (0, 0, 0)",
                    str(message.stamp_ns),
                )
            if id(message.laser) not in told:
                told.add(id(message.laser))
                out.write("".join(f"PARAM {p} {tail}" for p in _params(message.laser)))
            out.write(f"{_scan_line(message, pose)} {tail}")
        elif isinstance(message, Odometry):
            odom_T_body = message.odom_T_body
            out.write(f"ODOM {_pose(odom_T_body)} 0 0 0 {tail}")
        elif isinstance(message, Imu):
            findings.add("gyro-not-held", "CARMEN has no gyro: readings left out", str(message.stamp_ns))
        else:
            raise MfslamError(
                "a CARMEN log holds odometry poses, not wheel ticks or angles: "
                "write a ROS bag, or a URG text log, or odometry poses"
            )


def _params(laser: Laser) -> list[str]:
    side = "rear" if abs(laser.body_T_laser[2]) > 0.5 * math.pi else "front"
    return [
        f"robot_{side}laser_offset {laser.body_T_laser[0]:.6f}",
        f"robot_{side}_laser_max {laser.range_max_m:.6f}",
    ]


def _scan_line(scan: Scan, odom_T_body: FloatArray) -> str:
    laser, count = scan.laser, scan.ranges_m.shape[0]
    far = max(_NO_RETURN_M, math.ceil(laser.range_max_m) + 0.91)
    ranges = np.nan_to_num(scan.ranges_m, nan=0.0, posinf=far, neginf=0.0).astype(np.float32)
    text = " ".join(ranges.astype(str).tolist())  # the shortest text that reads back as the same float32
    poses = f"{_pose(se2.compose(odom_T_body, laser.body_T_laser))} {_pose(odom_T_body)}"
    if _is_sick(laser):
        kind = "RLASER" if abs(laser.body_T_laser[2]) > 0.5 * math.pi else "FLASER"
        return f"{kind} {count} {text} {poses}"
    step = even_step_rad(laser)
    kind_number = 2 if "urg" in laser.name.lower() else 99  # CARMEN's HOKUYO_URG, and unknown
    geometry = f"{kind_number} {laser.angles_rad[0]:.9f} {step * (count - 1):.9f} {step:.12f}"
    limits = f"{laser.range_max_m:.6f} {laser.range_sigma_m:.6f} 0"
    return f"ROBOTLASER1 {geometry} {limits} {count} {text} 0 {poses} 0 0 0 0 0"


def _is_sick(laser: Laser) -> bool:
    step_deg = _SICK_STEPS_DEG.get(laser.angles_rad.shape[0])
    if step_deg is None:
        return False
    expected = np.radians(-90.0 + step_deg * np.arange(laser.angles_rad.shape[0]))
    return bool(np.allclose(laser.angles_rad, expected, rtol=0.0, atol=1e-9))


def _pose(pose: FloatArray) -> str:
    return f"{pose[0]:.9f} {pose[1]:.9f} {pose[2]:.9f}"
