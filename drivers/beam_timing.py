"""How long a laser's turn takes, where a ROS log tells it badly.

A LaserScan says the time between beams (``time_increment``), but many ROS drivers leave it zero or get it
wrong by orders of magnitude; some fill in ``scan_time`` at least. What is told is believed when it fits the
pace of the scans, and that is counted over many of them: single ones come in bursts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mfslam.types import Findings

_PLAUSIBLE_SHARE = (0.3, 1.05)  # of the median gap between scans that one scan may last
_FOV_TOLERANCE = 0.2
# periods of common mirrors (SICK LMS 2xx and 1xx, Hokuyo): such a laser may be told right and still come
# far more slowly than it turns, over a serial line or with scans left out
_MIRRORS_S = (1.0 / 75.0, 0.02, 0.025, 0.04, 1.0 / 15.0, 0.1)
_MIRROR_TOLERANCE = 0.02
_PERIODS_S = (0.005, 2.0)  # of lasers' turns; a pace beyond is that of stamps, not of a laser
_LONG_SHARE = 1 / 6  # of the scans, over which their pace is counted


@dataclass(frozen=True)
class ScanTiming:
    """What the first scans of a log say: medians."""

    n_beams: int
    angle_step_rad: float
    time_increment_s: float
    gap_s: float | None  # between scans by their stamps; None with fewer than two stamps
    scan_time_s: float = 0.0


def usual_gap_s(stamps_ns: list[int]) -> float | None:
    """Time from scan to scan: their number over the time they took, the median over all stretches of a
    sixth of them. Bursts average out; pauses and clock jumps are in few stretches."""
    stamps = np.asarray(stamps_ns, dtype=np.int64)
    count = max(1, round(len(stamps) * _LONG_SHARE))
    spans = stamps[count:] - stamps[:-count]
    spans = spans[spans > 0]
    return float(np.median(spans)) * 1e-9 / count if spans.size else None


def turn_period_s(timing: ScanTiming, findings: Findings) -> float:
    """Period of the mirror's turn T_s (eq. 15), 0 for a snapshot. A repair is told in ``findings``."""
    span_rad = abs(timing.angle_step_rad) * (timing.n_beams - 1)
    told_s = timing.time_increment_s * (timing.n_beams - 1)
    if _is_plausible(told_s, span_rad, timing.gap_s):
        return told_s * 2.0 * math.pi / span_rad
    period_s, source = timing.scan_time_s, "scan_time says"
    if not (_is_period(period_s) and _fits_pace(period_s, timing.gap_s)):
        period_s, source = timing.gap_s or 0.0, "the scans come apart"
    if not _is_period(period_s) or not span_rad:
        findings.add(
            "time-increment-unknown",
            f"time_increment of {timing.time_increment_s:.3g} s is no use, and neither scan_time nor stamps tell "
            "how fast the laser turns: each scan is taken as a snapshot; set sensor.turn_period_s",
        )
        return 0.0
    apart = "unknown times" if timing.gap_s is None else f"{timing.gap_s:.3g} s"
    findings.add(
        "time-increment-repaired",
        f"time_increment of {timing.time_increment_s:.3g} s ({told_s:.3g} s for a scan) does not fit scans "
        f"{apart} apart: one turn is taken to last {period_s:.3g} s, as {source}; "
        "set sensor.turn_period_s if that is wrong (0: a snapshot)",
    )
    return period_s


def _is_period(period_s: float) -> bool:
    return _PERIODS_S[0] <= period_s <= _PERIODS_S[1]


def _fits_pace(period_s: float, gap_s: float | None) -> bool:
    least, most = _PLAUSIBLE_SHARE
    return gap_s is None or least * gap_s <= period_s <= most * gap_s


def _is_plausible(told_s: float, span_rad: float, gap_s: float | None) -> bool:
    if not (math.isfinite(told_s) and told_s > 0.0 and span_rad > 0.0):
        return False
    if gap_s is None:
        return told_s < 1.0
    share, fov_share = told_s / gap_s, span_rad / (2.0 * math.pi)
    if share > _PLAUSIBLE_SHARE[1]:
        return False
    period_s = told_s / fov_share
    return (
        share >= _PLAUSIBLE_SHARE[0]
        or abs(share - fov_share) < _FOV_TOLERANCE * fov_share
        or any(abs(period_s / mirror - 1.0) < _MIRROR_TOLERANCE for mirror in _MIRRORS_S)
    )
