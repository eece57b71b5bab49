"""What a process says of the memory that it held."""

from __future__ import annotations

import numpy as np

from mfslam.live.memory import forget_peak, peak_mb


def test_the_peak_is_that_since_it_was_forgotten() -> None:
    block = np.ones(20_000_000)  # 160 MB
    high_mb = peak_mb()
    del block
    assert peak_mb() > high_mb - 5.0  # the system counts in lots
    forget_peak()
    assert peak_mb() < high_mb - 100.0
