"""What a finished run knows that calibration needs: where the laser was, and what wheels and gyro told."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from mfslam import se2
from mfslam.types import BoolArray, FloatArray, IntArray, Laser


@dataclass(frozen=True, eq=False)
class Record:
    """``times_s`` (S,): reference instant of every scan on the wheels' clock, delay and drift as assumed.
    ``world_T_laser`` (S, 3): the laser then. ``sure`` (S,): whether the scan was matched, and no one's guess.
    ``laser``: as assumed. ``knots_s`` (K,), ``told_steps`` (K, 3): the wheels' steps as told, NaN where not known.
    ``stamps_back_s``: by how much stamps of one clock go backwards, which makes them worthless for delays.
    ``with_scans``: the wheels' poses came with the scans, told at an instant near theirs.
    ``gyro_times_s``, ``gyro_yaw_rad`` (G,): the gyro's turns so far, as told but for what was assumed of it.
    """

    times_s: FloatArray
    world_T_laser: FloatArray
    sure: BoolArray
    laser: Laser
    knots_s: FloatArray
    told_steps: FloatArray
    stamps_back_s: float = 0.0
    with_scans: bool = False
    gyro_times_s: FloatArray = field(default_factory=lambda: np.zeros(0))
    gyro_yaw_rad: FloatArray = field(default_factory=lambda: np.zeros(0))

    def windows(self, factor: float = 1.0) -> Windows:
        """Motions of the laser, end to end; ``factor``: times as long as usual."""
        return cut_windows(self, factor)


@dataclass(frozen=True, eq=False)
class Windows:
    """Motions of the laser from scan ``a`` (N,) to scan ``b`` (N,): ``a_T_b`` (N, 3). ``goes_on`` (N,): a window
    begins at the scan where the one before it ended, and shares that scan's error."""

    a: IntArray
    b: IntArray
    a_T_b: FloatArray
    goes_on: BoolArray

    def __len__(self) -> int:
        return len(self.a)

    def amounts(self) -> tuple[FloatArray, FloatArray]:
        """Way (N,) m and turn (N,) rad of every window."""
        return np.hypot(self.a_T_b[:, 0], self.a_T_b[:, 1]), np.abs(self.a_T_b[:, 2])

    def joined(self, count: int) -> tuple[IntArray, IntArray]:
        """First and last (M,) of every run of ``count`` successive windows."""
        first = np.arange(max(0, len(self) - count + 1))
        last = first + count - 1
        breaks = np.cumsum(~self.goes_on)
        whole = breaks[first] == breaks[last]
        return first[whole], last[whole]


LEAST_S = 0.19


@dataclass(frozen=True)
class Cut:
    """A window lasts until the robot has moved by ``least_m`` or ``least_rad``, and no longer than ``longest_s``."""

    least_m: float
    least_rad: float
    longest_s: float

    def times(self, factor: float) -> Cut:
        """Windows so many times as long."""
        return Cut(factor * self.least_m, factor * self.least_rad, factor * self.longest_s)


SHORT = Cut(0.08, 0.08, 1.2)
# of wheels read at instants of which only so much is known that they are near the scans': in a short window they tell of
# another motion than the laser saw, which looks as if they turned too little
LONG = Cut(1.0, 0.6, 20.0)
STANDING_M, STANDING_RAD = 0.02, 0.02  # a window in which less happens says nothing of wheels


def cut_windows(record: Record, factor: float = 1.0) -> Windows:
    """Windows of motion, end to end; standing, gaps and scans that are not sure lie between them. ``factor``: times as long
    as usual."""
    times, poses, sure = record.times_s, record.world_T_laser, record.sure
    cut = (LONG if record.with_scans else SHORT).times(factor)
    moved = se2.between(poses[:-1], poses[1:])
    way = np.concatenate([[0.0], np.cumsum(np.hypot(moved[:, 0], moved[:, 1]))])
    turn = np.concatenate([[0.0], np.cumsum(np.abs(moved[:, 2]))])
    a_all, b_all = [], []
    a = 0
    for n in range(1, len(times)):
        if not (sure[n] and sure[a]):
            a = n
            continue
        dt_s = times[n] - times[a]
        if dt_s < LEAST_S:
            continue
        far, turned = way[n] - way[a], turn[n] - turn[a]
        if dt_s > cut.longest_s:
            a = n
        elif far >= cut.least_m or turned >= cut.least_rad:
            a_all.append(a)
            b_all.append(n)
            a = n
        elif dt_s > 0.8 * cut.longest_s:
            if far > STANDING_M or turned > STANDING_RAD:
                a_all.append(a)
                b_all.append(n)
            a = n
    return windows_between(poses, np.array(a_all, dtype=np.int64), np.array(b_all, dtype=np.int64))


def windows_between(world_T_laser: FloatArray, a: IntArray, b: IntArray) -> Windows:
    goes_on = np.concatenate([[False], a[1:] == b[:-1]]) if len(a) else np.zeros(0, dtype=np.bool_)
    return Windows(a, b, se2.between(world_T_laser[a], world_T_laser[b]), goes_on)


def without(windows: Windows, bad: BoolArray) -> Windows:
    """The windows but for the bad ones (N,)."""
    keep = ~bad
    a, b = windows.a[keep], windows.b[keep]
    goes_on = np.concatenate([[False], a[1:] == b[:-1]]) if len(a) else np.zeros(0, dtype=np.bool_)
    return replace(windows, a=a, b=b, a_T_b=windows.a_T_b[keep], goes_on=goes_on)
