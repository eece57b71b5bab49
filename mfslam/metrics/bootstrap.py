"""Whether one result is better than another or only luckier: a paired bootstrap."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mfslam.types import FloatArray

SAMPLES = 2000


@dataclass(frozen=True, slots=True)
class Difference:
    """Mean of b minus mean of a, its 95 % interval and the two-sided p-value that there is none."""

    mean: float
    low: float
    high: float
    p: float
    pairs: int

    @property
    def significant(self) -> bool:
        return self.low > 0.0 or self.high < 0.0

    def as_json(self) -> dict[str, Any]:
        return {
            "mean_difference": self.mean,
            "interval_95": [self.low, self.high],
            "p_value": self.p,
            "significant": self.significant,
            "pairs": self.pairs,
        }


def paired_bootstrap(a: FloatArray, b: FloatArray, samples: int = SAMPLES, seed: int = 0) -> Difference:
    """Of errors (N,) of two results over the same pairs, in the order of time.

    Neighbours err alike, so blocks of N^(1/3) of them are drawn, not single ones (Kuensch 1989).
    """
    rng = np.random.default_rng(seed)
    d = b - a
    count = len(d)
    block = max(1, round(count ** (1.0 / 3.0)))
    round_trip = np.concatenate([d, d[: block - 1]])
    sums = np.convolve(round_trip, np.ones(block), "valid")  # of the block that begins at each pair
    starts = rng.integers(0, count, (samples, -(-count // block)))
    means = sums[starts].sum(axis=1) / (starts.shape[1] * block)
    low, high = np.percentile(means, [2.5, 97.5])
    tail = min(np.mean(means <= 0.0), np.mean(means >= 0.0))
    p = float(np.clip(2.0 * (tail * samples + 1.0) / (samples + 1.0), 0.0, 1.0))
    return Difference(float(d.mean()), float(low), float(high), p, count)
