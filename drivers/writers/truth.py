"""Ground truth of a simulated log: as a TUM trajectory, and as relations between scans."""

from __future__ import annotations

import math
from contextlib import suppress
from pathlib import Path

import numpy as np

from drivers.writers.text import seconds
from mfslam import se2
from mfslam.types import FloatArray, IntArray, MfslamError


def write_tum(path: Path | str, stamps_ns: IntArray, world_T_body: FloatArray) -> None:
    """One line ``stamp x y z qx qy qz qw`` per pose; stamps (S,), poses (S, 3)."""
    lines = []
    for stamp, (x, y, yaw) in zip(stamps_ns.tolist(), world_T_body.tolist(), strict=True):
        z, w = math.sin(0.5 * yaw), math.cos(0.5 * yaw)
        lines.append(f"{seconds(stamp)} {x:.9f} {y:.9f} 0 0 0 {z:.12f} {w:.12f}\n")
    _write(Path(path), lines)


def write_relations(
    path: Path | str,
    stamps_ns: IntArray,
    world_T_body: FloatArray,
    *,
    per_scale: int = 500,
    seed: int = 0,
) -> None:
    """Lines ``t1 t2 x y z roll pitch yaw``: the pose at t2 seen from t1 (Kuemmerle et al. 2009).

    Up to ``per_scale`` pairs of neighbouring scans, and as many of any two scans, drawn from ``seed``.
    """
    count = len(stamps_ns)
    rng = np.random.default_rng(seed)
    near = np.unique(np.linspace(0, count - 2, min(per_scale, max(count - 1, 0))).astype(np.int64))
    pairs = [(i, i + 1) for i in near.tolist()]
    if count > 2:
        far = np.sort(rng.integers(0, count, (per_scale, 2)), axis=1)
        pairs += [(i, j) for i, j in np.unique(far, axis=0).tolist() if j > i + 1]
    lines = []
    for i, j in pairs:
        x, y, yaw = se2.between(world_T_body[i], world_T_body[j]).tolist()
        t1, t2 = seconds(int(stamps_ns[i])), seconds(int(stamps_ns[j]))
        lines.append(f"{t1} {t2} {x:.9f} {y:.9f} 0 0 0 {yaw:.12f}\n")
    _write(Path(path), lines)


def _write(path: Path, lines: list[str]) -> None:
    aside = path.with_name(f".{path.name}.writing")
    try:
        aside.write_text("".join(lines), encoding="ascii")
        aside.replace(path)
    except OSError as error:
        with suppress(OSError):
            aside.unlink()
        raise MfslamError(f"{path}: cannot be written: {error.strerror or error}") from None
