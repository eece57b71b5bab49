"""Points of a turn on even beams."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.turning_laser import on_beams


def test_points_come_to_even_beams() -> None:
    angles_deg = np.array([22.5, 67.5, 112.5, 130.0, 200.0])
    ranges_mm = np.array([1000.0, 1040.0, 3000.0, 0.0, 2000.0])
    ranges = on_beams(angles_deg, ranges_mm, 8)
    assert ranges[1] == pytest.approx(1.02)  # between two points of one wall
    assert ranges[2] in (np.float32(1.04), np.float32(3.0))  # an edge: one of them, nothing between
    assert np.isnan(ranges[3]) and np.isnan(ranges[6]) and np.isnan(ranges[7])
