"""Runs of a few scans: everything that is written is finite."""

from __future__ import annotations

from itertools import islice

import numpy as np
import pytest
from short_logs import drive

from mfslam.config import Config
from mfslam.slam import Slam
from mfslam.types import Scan


@pytest.mark.parametrize("scans", [1, 2, 5, 13, 17, 24])
def test_a_run_of_a_few_scans_states_finite_covariances(scans: int) -> None:
    messages = drive().messages
    end = list(islice((n for n, message in enumerate(messages) if isinstance(message, Scan)), scans + 1))[-1]
    slam = Slam(Config())
    for message in messages[:end]:
        slam.feed(message)
    solution = slam.finish()
    assert solution.covariances.shape == (scans, 3, 3)
    assert np.isfinite(solution.covariances).all()
    assert np.all(np.linalg.eigvalsh(solution.covariances) > -1e-12)
