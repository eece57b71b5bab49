"""Error against relations (Kuemmerle et al., On measuring the accuracy of SLAM algorithms, Autonomous Robots 2009)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mfslam import se2
from mfslam.metrics.matching import nearest, range_text
from mfslam.metrics.statistics import ErrorStats
from mfslam.se2 import LARGEST, are_of_a_pose
from mfslam.types import BoolArray, FloatArray, IntArray, MfslamError

_NS = 1_000_000_000


@dataclass(frozen=True, eq=False)
class Relations:
    """Ground truth of pairs: ``a_T_b`` (R, 3), the pose at ``b_ns`` (R,) seen from the one at ``a_ns``."""

    a_ns: IntArray
    b_ns: IntArray
    a_T_b: FloatArray


@dataclass(frozen=True, slots=True)
class RelationsError:
    """Absolute errors of inverse(relation) * estimate over the matched relations."""

    translation_m: ErrorStats
    rotation_deg: ErrorStats
    matched: int
    unmatched: int

    def as_json(self) -> dict[str, Any]:
        return {
            "translation_m": self.translation_m.as_json(),
            "rotation_deg": self.rotation_deg.as_json(),
            "matched": self.matched,
            "unmatched": self.unmatched,
        }


def read_relations(path: Path) -> Relations:
    """Read lines of ``t1 t2 x y z roll pitch yaw`` (s, m, rad); ``#`` starts a comment.

    Raises MfslamError with file and line for anything else.
    """
    stamps: list[tuple[int, int]] = []
    poses: list[tuple[float, float, float]] = []
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except OSError as error:
        raise MfslamError(f"{path}: cannot be read: {(error.strerror or str(error)).lower()}") from None
    except UnicodeDecodeError:
        raise MfslamError(f"{path}: expected a text file of relations, got binary data") from None
    for number, line in enumerate(lines, start=1):
        fields = line.partition("#")[0].split()
        if not fields:
            continue
        try:
            t1, t2, x, y, _z, _roll, _pitch, yaw = (float(field) for field in fields)
            # a float of 1e9 s is good to 0.2 us: far below the tolerance of the matching
            pair = (round(t1 * _NS), round(t2 * _NS))
        except (ValueError, OverflowError):
            raise MfslamError(
                f"{path}:{number}: expected 't1 t2 x y z roll pitch yaw', got {line[:80]!r}"
            ) from None
        if not are_of_a_pose((x, y, yaw)) or max(map(abs, pair)) >= 2**63:
            raise MfslamError(
                f"{path}:{number}: expected finite numbers up to {LARGEST:g} (stamps 9e9), got {line[:80]!r}"
            )
        stamps.append(pair)
        poses.append((x, y, yaw))
    if not stamps:
        raise MfslamError(f"{path}: holds no relation; expected lines of 't1 t2 x y z roll pitch yaw'")
    pairs = np.array(stamps, dtype=np.int64)
    return Relations(pairs[:, 0], pairs[:, 1], np.array(poses, dtype=np.float64))


def relation_errors(
    stamps_ns: IntArray, world_T_body: FloatArray, relations: Relations, tolerance_s: float = 1e-5
) -> tuple[FloatArray, BoolArray]:
    """(M, 3) inverse(relation) * estimate of the matched relations, and which (R,) of all are matched.

    Poses (N, 3) at stamps (N,) in any order; a relation counts when both of its stamps are within
    ``tolerance_s`` of a pose's. Raises MfslamError, telling both time ranges, when none does.
    """
    a, a_found = nearest(stamps_ns, relations.a_ns, tolerance_s)
    b, b_found = nearest(stamps_ns, relations.b_ns, tolerance_s)
    both = a_found & b_found
    if not both.any():
        raise MfslamError(
            "no relation has a pose at both of its stamps: relations run from "
            f"{range_text(np.concatenate([relations.a_ns, relations.b_ns]))}, poses from {range_text(stamps_ns)}"
        )
    estimate = se2.between(world_T_body[a[both]], world_T_body[b[both]])
    return se2.between(relations.a_T_b[both], estimate), both


def relations_error(
    stamps_ns: IntArray, world_T_body: FloatArray, relations: Relations, tolerance_s: float = 1e-5
) -> RelationsError:
    """Statistics of `relation_errors`."""
    error, matched = relation_errors(stamps_ns, world_T_body, relations, tolerance_s)
    return RelationsError(
        ErrorStats.of(np.hypot(error[:, 0], error[:, 1])),
        ErrorStats.of(np.degrees(np.abs(error[:, 2]))),
        int(matched.sum()),
        int((~matched).sum()),
    )
