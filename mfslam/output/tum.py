"""TUM trajectories: one line per pose, ``stamp x y z qx qy qz qw``, seconds and metres."""

from __future__ import annotations

import math
from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np

from mfslam.output.reading import read_lines
from mfslam.se2 import LARGEST, are_of_a_pose
from mfslam.types import FloatArray, IntArray, MfslamError

_NS = 1_000_000_000
_HEADER = "# stamp_s x_m y_m z_m qx qy qz qw (world_T_body)\n"


def stamp_text(stamp_ns: int) -> str:
    """Exact decimal seconds, nine decimals: no float in between, so the log's stamp is kept."""
    seconds, rest = divmod(abs(stamp_ns), _NS)
    return f"{'-' if stamp_ns < 0 else ''}{seconds}.{rest:09d}"


def stamp_from_text(text: str) -> int:
    """Nanoseconds of decimal seconds, exactly. Raises ValueError when it is no number or 64 bits do not hold it."""
    try:
        stamp_ns = int((Decimal(text) * _NS).to_integral_value())
    except (InvalidOperation, OverflowError):
        raise ValueError(f"no number: {text!r}") from None
    if abs(stamp_ns) >= 2**63:
        raise ValueError(f"no stamp within 292 years of zero: {text!r}")
    return stamp_ns


def trajectory_text(stamps_ns: IntArray, world_T_body: FloatArray) -> str:
    """TUM text of planar poses (N, 3) in the order given; z, qx and qy are zero."""
    half = 0.5 * world_T_body[:, 2]
    rows = zip(
        stamps_ns.tolist(),
        world_T_body[:, 0].tolist(),
        world_T_body[:, 1].tolist(),
        np.sin(half).tolist(),
        np.cos(half).tolist(),
        strict=True,
    )
    return _HEADER + "".join(
        f"{stamp_text(stamp)} {x:.9f} {y:.9f} 0 0 0 {qz:.12f} {qw:.12f}\n" for stamp, x, y, qz, qw in rows
    )


def read_tum(path: Path) -> tuple[IntArray, FloatArray]:
    """Stamps (N,) in ns and planar poses world_T_body (N, 3) of a TUM file, in file order.

    z and the tilt are dropped. Raises MfslamError with file and line for anything else than eight finite
    numbers with a unit quaternion.
    """
    stamps: list[int] = []
    poses: list[tuple[float, float, float]] = []
    for number, line in read_lines(path):
        fields = line.split()
        if not fields or fields[0].startswith("#"):
            continue
        where = f"{path}:{number}"
        try:
            stamp_ns = stamp_from_text(fields[0])
            x, y, z, qx, qy, qz, qw = (float(field) for field in fields[1:])
        except ValueError:
            raise MfslamError(f"{where}: expected 'stamp x y z qx qy qz qw', got {line[:80]!r}") from None
        if not are_of_a_pose((x, y, z, qx, qy, qz, qw)):
            raise MfslamError(f"{where}: expected finite numbers up to {LARGEST:g}, got {line[:80]!r}")
        if abs(math.hypot(qx, qy, qz, qw) - 1.0) > 1e-3:
            raise MfslamError(
                f"{where}: expected a unit quaternion, got length {math.hypot(qx, qy, qz, qw):.4g}"
            )
        yaw = math.atan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy * qy + qz * qz))
        stamps.append(stamp_ns)
        poses.append((x, y, yaw))
    if not stamps:
        raise MfslamError(f"{path}: holds no pose; expected lines of 'stamp x y z qx qy qz qw'")
    return np.array(stamps, dtype=np.int64), np.array(poses, dtype=np.float64)
