"""URG text logs with encoder ticks (as CoreSLAM's robot wrote them): one line per scan.

Columns: 0 stamp in microseconds; 2, 3 encoder ticks of the first and second wheel; 24 to 705 the 682
ranges in mm, 0 = none; all other columns 0. Stamps are rounded to 1 us, ranges to 1 mm.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import IO

import numpy as np

from mfslam.types import Findings, Message, MfslamError, Scan, WheelTicks

BEAMS = 682
_COLUMNS_BEFORE_RANGES = 24
_SAME_INSTANT_NS = 1_000_000


def write_urg_text(
    messages: Iterable[Message], out: IO[str], findings: Findings, swap_sides: bool = False
) -> None:
    """``swap_sides``: the first wheel of the log is the right one (as WheelsConfig.swap_sides)."""
    ticks: WheelTicks | None = None
    for message in messages:
        if isinstance(message, WheelTicks):
            ticks = message
        elif isinstance(message, Scan):
            out.write(_line(message, ticks, swap_sides))
        else:
            findings.add(
                "not-held",
                f"a URG text log has no {type(message).__name__}: left out",
                str(message.stamp_ns),
            )


def _line(scan: Scan, ticks: WheelTicks | None, swap_sides: bool) -> str:
    if scan.ranges_m.shape[0] != BEAMS:
        raise MfslamError(f"a URG text log has {BEAMS} beams per scan, got {scan.ranges_m.shape[0]}")
    if ticks is None or abs(ticks.stamp_ns - scan.stamp_ns) > _SAME_INSTANT_NS:
        raise MfslamError(
            f"scan at {scan.stamp_ns} ns: a URG text log needs encoder ticks of the same instant just before "
            "each scan; read the encoders at the scans' stamps"
        )
    sides = (ticks.right, ticks.left) if swap_sides else (ticks.left, ticks.right)
    finite = np.where(np.isfinite(scan.ranges_m), scan.ranges_m, 0.0)
    ranges_mm = " ".join(map(str, np.rint(finite * 1000.0).astype(np.int64).tolist()))
    rest = " ".join(["0"] * (_COLUMNS_BEFORE_RANGES - 4))
    return f"{round(scan.stamp_ns / 1000)} 0 {sides[0]} {sides[1]} {rest} {ranges_mm} 0\n"
