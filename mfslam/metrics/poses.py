"""Errors of a trajectory against the true one, pose by pose: absolute (ATE) and of steps (RPE)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from mfslam import se2
from mfslam.metrics.statistics import ErrorStats
from mfslam.types import FloatArray

Alignment = Literal["none", "origin", "best"]


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

    def as_json(self) -> dict[str, Any]:
        return {"translation_m": self.translation_m.as_json(), "rotation_deg": self.rotation_deg.as_json()}

    @classmethod
    def of(cls, errors: FloatArray) -> PoseError:
        return cls(
            ErrorStats.of(np.hypot(errors[:, 0], errors[:, 1])),
            ErrorStats.of(np.degrees(np.abs(errors[:, 2]))),
        )


def absolute_errors(truth: FloatArray, estimate: FloatArray, alignment: Alignment = "best") -> FloatArray:
    """(N, 3): inverse(truth) * estimate of matched poses (N, 3).

    ``alignment``: none, the first pose on the first (origin), or the best rigid fit of the positions.
    """
    if alignment == "origin":
        truth_T_estimate = se2.compose(truth[0], se2.inverse(estimate[0]))
    elif alignment == "best":
        truth_T_estimate = align(truth, estimate)
    else:
        truth_T_estimate = np.zeros(3)
    return se2.between(truth, se2.compose(truth_T_estimate, estimate))


def ate(truth: FloatArray, estimate: FloatArray, alignment: Alignment = "best") -> PoseError:
    """Absolute trajectory error: statistics of `absolute_errors`."""
    return PoseError.of(absolute_errors(truth, estimate, alignment))


def rpe(truth: FloatArray, estimate: FloatArray, step: int = 1) -> PoseError:
    """Relative pose error over all pairs ``step`` poses apart, of matched poses (N, 3), N > step."""
    true_step = se2.between(truth[:-step], truth[step:])
    estimated_step = se2.between(estimate[:-step], estimate[step:])
    return PoseError.of(se2.between(true_step, estimated_step))
