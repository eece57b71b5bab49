"""trajectory.cov: how uncertain every pose of trajectory.tum is."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from mfslam.output.reading import read_lines
from mfslam.output.tum import stamp_from_text, stamp_text
from mfslam.types import FloatArray, IntArray, MfslamError

_HEADER = (
    "# stamp_s xx xy xyaw yy yyaw yawyaw (covariance of x, y, yaw in the world's axes, relative to the first pose; "
    "m^2, m rad, rad^2)\n"
)
_UPPER = np.triu_indices(3)


def covariances_text(stamps_ns: IntArray, covariances: FloatArray) -> str:
    """One line per pose (N, 3, 3): its stamp and the upper triangle by rows."""
    rows = covariances[:, _UPPER[0], _UPPER[1]].tolist()
    return _HEADER + "".join(
        f"{stamp_text(stamp)} {' '.join(f'{v:.6e}' for v in row)}\n"
        for stamp, row in zip(stamps_ns.tolist(), rows, strict=True)
    )


def read_covariances(path: Path) -> tuple[IntArray, FloatArray]:
    """Stamps (N,) in ns and covariances (N, 3, 3) of x, y and yaw, in file order.

    Raises MfslamError with file and line for anything else than a stamp and six finite numbers.
    """
    stamps: list[int] = []
    upper: list[list[float]] = []
    for number, line in read_lines(path):
        fields = line.split()
        if not fields or fields[0].startswith("#"):
            continue
        try:
            stamp_ns = stamp_from_text(fields[0])
            values = [float(field) for field in fields[1:]]
        except ValueError:
            values = []
        if len(values) != 6 or not all(map(math.isfinite, values)):
            raise MfslamError(
                f"{path}:{number}: expected 'stamp xx xy xyaw yy yyaw yawyaw', got {line[:80]!r}"
            )
        stamps.append(stamp_ns)
        upper.append(values)
    if not stamps:
        raise MfslamError(f"{path}: holds no covariance; expected lines of 'stamp xx xy xyaw yy yyaw yawyaw'")
    out = np.empty((len(upper), 3, 3))
    out[:, _UPPER[0], _UPPER[1]] = upper
    out[:, _UPPER[1], _UPPER[0]] = upper
    return np.array(stamps, dtype=np.int64), out
