"""How good a trajectory or a map is: relations error, ATE, RPE, crispness."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from mfslam import se2
from mfslam.types import BoolArray, FloatArray, IntArray, MfslamError

Alignment = Literal["none", "origin", "best"]
_NS = 1_000_000_000


@dataclass(frozen=True, slots=True)
class ErrorStats:
    """Statistics of absolute errors; ``mean_squared`` in squared units, ``rmse`` its root."""

    mean: float
    std: float
    median: float
    p99: float
    max: float
    mean_squared: float

    @property
    def rmse(self) -> float:
        return math.sqrt(self.mean_squared)

    @classmethod
    def of(cls, errors: FloatArray) -> ErrorStats:
        """Statistics of non-negative errors (N,), N > 0."""
        return cls(
            float(np.mean(errors)),
            float(np.std(errors)),
            float(np.median(errors)),
            float(np.percentile(errors, 99)),
            float(np.max(errors)),
            float(np.mean(np.square(errors))),
        )


# --- relations (Kuemmerle et al., On measuring the accuracy of SLAM algorithms, Autonomous Robots 2009) --


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
            "translation_m": _stats_json(self.translation_m),
            "rotation_deg": _stats_json(self.rotation_deg),
            "matched": self.matched,
            "unmatched": self.unmatched,
        }


def _stats_json(stats: ErrorStats) -> dict[str, float]:
    return {
        name: getattr(stats, name) for name in ("mean", "std", "median", "p99", "max", "mean_squared", "rmse")
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
        if not all(map(math.isfinite, (x, y, yaw))):
            raise MfslamError(f"{path}:{number}: expected finite numbers, got {line[:80]!r}")
        stamps.append(pair)
        poses.append((x, y, yaw))
    if not stamps:
        raise MfslamError(f"{path}: holds no relation; expected lines of 't1 t2 x y z roll pitch yaw'")
    pairs = np.array(stamps, dtype=np.int64)
    return Relations(pairs[:, 0], pairs[:, 1], np.array(poses, dtype=np.float64))


def relations_error(
    stamps_ns: IntArray, world_T_body: FloatArray, relations: Relations, tolerance_s: float = 1e-5
) -> RelationsError:
    """Error of a trajectory, poses (N, 3) at stamps (N,) in any order, against ground-truth relations.

    A relation counts when both of its stamps are within ``tolerance_s`` of a pose's. Raises MfslamError,
    telling both time ranges, when none does.
    """
    a, a_found = _nearest(stamps_ns, relations.a_ns, tolerance_s)
    b, b_found = _nearest(stamps_ns, relations.b_ns, tolerance_s)
    both = a_found & b_found
    if not both.any():
        raise MfslamError(
            "no relation has a pose at both of its stamps: relations run from "
            f"{_range_text(np.concatenate([relations.a_ns, relations.b_ns]))}, poses from {_range_text(stamps_ns)}"
        )
    estimate = se2.between(world_T_body[a[both]], world_T_body[b[both]])
    error = se2.between(relations.a_T_b[both], estimate)
    return RelationsError(
        ErrorStats.of(np.hypot(error[:, 0], error[:, 1])),
        ErrorStats.of(np.degrees(np.abs(error[:, 2]))),
        int(both.sum()),
        int((~both).sum()),
    )


def _nearest(stamps_ns: IntArray, wanted_ns: IntArray, tolerance_s: float) -> tuple[IntArray, BoolArray]:
    """Index of the pose nearest in time to each wanted stamp, and whether it is near enough."""
    if len(stamps_ns) == 0:
        return np.zeros(len(wanted_ns), dtype=np.int64), np.zeros(len(wanted_ns), dtype=np.bool_)
    order = np.argsort(stamps_ns, kind="stable")  # the log's order need not be the clock's
    ordered = stamps_ns[order]
    right = np.minimum(np.searchsorted(ordered, wanted_ns), len(ordered) - 1)
    left = np.maximum(right - 1, 0)
    nearer_left = np.abs(ordered[left] - wanted_ns) <= np.abs(ordered[right] - wanted_ns)
    position = np.where(nearer_left, left, right)
    return order[position], np.abs(ordered[position] - wanted_ns) <= round(tolerance_s * _NS)


def _range_text(stamps_ns: IntArray) -> str:
    if len(stamps_ns) == 0:
        return "nothing"
    return f"{stamps_ns.min() / _NS:.6f} to {stamps_ns.max() / _NS:.6f} s"


# --- against a true trajectory -----------------------------------------------------------------------


def associate(a_ns: IntArray, b_ns: IntArray, max_difference_s: float = 0.01) -> tuple[IntArray, IntArray]:
    """Indices into ``a_ns`` and ``b_ns`` of poses of one instant: each of a with its nearest of b.

    Raises MfslamError, telling both time ranges, when there are none.
    """
    nearest, found = _nearest(b_ns, a_ns, max_difference_s)
    if not found.any():
        raise MfslamError(
            f"no poses within {max_difference_s} s of each other: one trajectory runs from {_range_text(a_ns)}, "
            f"the other from {_range_text(b_ns)}"
        )
    return np.flatnonzero(found), nearest[found]


def align(truth: FloatArray, estimate: FloatArray) -> FloatArray:
    """truth_T_estimate (3,): the rigid motion that carries the estimate's positions (N, 2+) closest to the
    truth's (Umeyama 1991 without scale, planar closed form)."""
    mean_t, mean_e = truth[:, :2].mean(axis=0), estimate[:, :2].mean(axis=0)
    t, e = truth[:, :2] - mean_t, estimate[:, :2] - mean_e
    theta = np.arctan2(np.sum(e[:, 0] * t[:, 1] - e[:, 1] * t[:, 0]), np.sum(e * t))
    c, s = np.cos(theta), np.sin(theta)
    return np.array(
        [mean_t[0] - c * mean_e[0] + s * mean_e[1], mean_t[1] - s * mean_e[0] - c * mean_e[1], theta]
    )


@dataclass(frozen=True, slots=True)
class PoseError:
    """Translation (m) and rotation (deg) errors of poses, absolute (ATE) or of steps (RPE)."""

    translation_m: ErrorStats
    rotation_deg: ErrorStats

    @classmethod
    def of(cls, errors: FloatArray) -> PoseError:
        return cls(
            ErrorStats.of(np.hypot(errors[:, 0], errors[:, 1])),
            ErrorStats.of(np.degrees(np.abs(errors[:, 2]))),
        )


def ate(truth: FloatArray, estimate: FloatArray, alignment: Alignment = "best") -> PoseError:
    """Absolute trajectory error of matched poses (N, 3).

    ``alignment``: none, the first pose on the first (origin), or the best rigid fit of the positions.
    """
    if alignment == "origin":
        truth_T_estimate = se2.compose(truth[0], se2.inverse(estimate[0]))
    elif alignment == "best":
        truth_T_estimate = align(truth, estimate)
    else:
        truth_T_estimate = np.zeros(3)
    return PoseError.of(se2.between(truth, se2.compose(truth_T_estimate, estimate)))


def rpe(truth: FloatArray, estimate: FloatArray, step: int = 1) -> PoseError:
    """Relative pose error over all pairs ``step`` poses apart, of matched poses (N, 3), N > step."""
    true_step = se2.between(truth[:-step], truth[step:])
    estimated_step = se2.between(estimate[:-step], estimate[step:])
    return PoseError.of(se2.between(true_step, estimated_step))


# --- the map itself ----------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Crispness:
    """How sharp a cloud of hits is: cells that hold any, and the entropy of the hits over cells.

    Both are lower for a sharper map of the same scans.
    """

    cells: int
    entropy_nats: float

    @property
    def entropy_bits(self) -> float:
        return self.entropy_nats / math.log(2.0)

    def as_json(self) -> dict[str, Any]:
        return {"cells": self.cells, "entropy_nats": self.entropy_nats, "entropy_bits": self.entropy_bits}


def crispness(points_m: FloatArray, resolution_m: float = 0.02) -> Crispness:
    """Crispness of points (P, 2) over cells of ``resolution_m``; entropy is -sum p log p over cells hit."""
    if len(points_m) == 0:
        return Crispness(0, 0.0)
    low, high = np.floor(points_m.min(axis=0) / resolution_m), np.floor(points_m.max(axis=0) / resolution_m)
    # one column after the other, sorted in place: clouds are large
    keys = (np.floor(points_m[:, 0] / resolution_m) - low[0]).astype(np.int64)
    keys *= int(high[1] - low[1]) + 1
    keys += (np.floor(points_m[:, 1] / resolution_m) - low[1]).astype(np.int64)
    keys.sort()
    starts = np.flatnonzero(np.concatenate([[True], keys[1:] != keys[:-1]]))
    share = np.diff(starts, append=len(keys)) / len(keys)
    return Crispness(len(share), float(-np.sum(share * np.log(share))))
