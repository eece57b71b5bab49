"""What a laser's ranges are wrong by at which range, taken off before anything else looks at them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mfslam.config import SensorConfig
from mfslam.types import Float32Array, FloatArray, Scan


def range_errors_m(sensor: SensorConfig, ranges_m: FloatArray | Float32Array) -> FloatArray:
    """By how much ranges (N,), as told, are too large: linear between the knots of the settings, as the last one beyond."""
    if not sensor.range_error_m:
        return np.zeros(len(ranges_m))
    knots_m = sensor.range_error_step_m * np.arange(len(sensor.range_error_m))
    return np.asarray(np.interp(ranges_m, knots_m, sensor.range_error_m))


def with_true_ranges(scan: Scan, sensor: SensorConfig) -> Scan:
    """The scan less the errors of its ranges."""
    if not sensor.range_error_m:
        return scan
    ranges_m = scan.ranges_m - range_errors_m(sensor, scan.ranges_m)
    return replace(scan, ranges_m=ranges_m.astype(np.float32))
