"""Where to begin: the delay by the laser's turning against the wheels', and which wheel is which by its sign.

The turn is linear in what both wheels rolled, theta' = J21 a_first + J22 a_second (Censi et al. 2013, eq. 15), whatever the
mount is. A left wheel has a negative J, a right wheel a positive one: two wheels that are swapped, or one that counts
backwards, show in the signs. Both swapped and both reversed look alike in turns; the direction of driving tells them apart.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mfslam.calibration.record import Record, Windows
from mfslam.types import FloatArray

REACH_S, STEP_S = 1.0, 0.02
CAP_SIGMAS = 3.0
LEAST_TURN_RAD = 2.0  # all turning of a log, for a delay or a sign to be seen


@dataclass(frozen=True, eq=False)
class Start:
    """``delay_s`` beyond what was assumed; ``signs`` (2, 2): real left and right wheel of those told."""

    delay_s: float
    signs: FloatArray
    track_share: float
    correlation: float

    @property
    def words(self) -> str:
        """What is odd of the wheels; empty when nothing is."""
        if np.array_equal(self.signs, np.eye(2)):
            return ""
        swapped = self.signs[0, 0] == 0.0
        reverse = [name for name, row in zip(("left", "right"), self.signs, strict=True) if row.sum() < 0.0]
        parts = ["left and right wheel are swapped"] if swapped else []
        parts += [f"the {name} wheel counts backwards" for name in reverse]
        return " and ".join(parts)


def find_start(record: Record, windows: Windows, track_m: float, clock: bool) -> Start:
    """By the laser's turns (N,) over the windows, for every delay within reach."""
    a, b = record.times_s[windows.a], record.times_s[windows.b]
    turn = windows.a_T_b[:, 2]
    known = np.nan_to_num(record.told_steps)
    half = 0.5 * track_m * known[:, 2]
    rolled = np.cumsum(np.stack([known[:, 0] - half, known[:, 0] + half]), axis=1)

    def moved(delay_s: float) -> FloatArray:
        return np.stack(
            [
                np.interp(b + delay_s, record.knots_s, side) - np.interp(a + delay_s, record.knots_s, side)
                for side in rolled
            ],
            axis=1,
        )

    def fit(delay_s: float) -> tuple[float, FloatArray]:
        rows, weights = moved(delay_s), np.ones(len(turn))
        j: FloatArray = np.zeros(2)
        cost = float(np.sum(turn**2))
        for _ in range(3):
            j = np.asarray(np.linalg.lstsq(rows * weights[:, None], turn * weights, rcond=None)[0])
            off = np.abs(turn - rows @ j)
            cap = CAP_SIGMAS * max(1.5 * float(np.median(off)), 1e-3)
            weights = np.minimum(1.0, cap / np.maximum(off, 1e-9))
            cost = float(np.sum(np.minimum(off, cap) * off * weights))
        return cost, j

    delays = np.arange(-REACH_S, REACH_S + 0.5 * STEP_S, STEP_S) if clock else np.zeros(1)
    if np.abs(turn).sum() < LEAST_TURN_RAD:
        return Start(0.0, np.eye(2), 1.0, 0.0)
    costs = [fit(float(delay))[0] for delay in delays]
    delay_s = float(delays[int(np.argmin(costs))])
    _, j = fit(delay_s)
    rows = moved(delay_s)
    told = rows @ j
    correlation = float(np.corrcoef(told, turn)[0, 1]) if told.std() > 0.0 else 0.0
    signs = _signs(j, rows, windows, record)
    share = float(np.clip(2.0 / (np.abs(j).sum() * track_m), 0.2, 5.0)) if np.abs(j).sum() > 0.0 else 1.0
    return Start(delay_s, signs, share, correlation)


def _signs(j: FloatArray, rows: FloatArray, windows: Windows, record: Record) -> FloatArray:
    if abs(j[0]) < 0.2 * abs(j[1]) or abs(j[1]) < 0.2 * abs(j[0]):
        return np.eye(2)  # one of them says nothing of turns: no differential drive
    first, second = np.sign(j)
    as_told = np.diag([-first, second])
    swapped = np.array([[0.0, -second], [first, 0.0]])
    yaw = record.laser.body_T_laser[2]
    ahead = np.cos(yaw) * windows.a_T_b[:, 0] - np.sin(yaw) * windows.a_T_b[:, 1]
    straight = np.abs(windows.a_T_b[:, 2]) < 0.1
    rolled = (rows @ as_told.T).sum(axis=1)
    return as_told if float(np.sum(rolled[straight] * ahead[straight])) >= 0.0 else swapped
