"""Statistics of absolute errors."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from mfslam.types import FloatArray


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

    def as_json(self) -> dict[str, Any]:
        names = ("mean", "std", "median", "p99", "max", "mean_squared", "rmse")
        return {name: getattr(self, name) for name in names}
