"""Lasers that turn all the way round and tell bearing and range of each point, but no time.

A turn ends when the next one's first point arrives, and its points are spread over it.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from drivers.laser_models import LogGeometry, clean_ranges, laser_from
from drivers.live_sensor import LiveSensor
from drivers.transport import Transport
from mfslam.config import Config
from mfslam.types import Float32Array, FloatArray, Laser, Message, Scan

FIRST_TURNS = 5  # turns that tell the number of beams
PACE_TURNS = 11
CATCH_UP = 0.1  # of a turn's lateness that is believed
SAME_SURFACE = 0.1  # neighbouring ranges this near, relative, belong to one surface


@dataclass(frozen=True, eq=False)
class Turn:
    """Points of one turn from bearing 0 on: ``angles_deg`` (N,) in the direction in which it turns, ``ranges_mm`` (N,), 0
    for nothing. ``ended_s``: arrival of the next turn's first point; ``last_s``: of the last byte that was read."""

    angles_deg: FloatArray
    ranges_mm: FloatArray
    ended_s: float
    last_s: float


class TurningLaser(LiveSensor):
    """Scans with evenly spaced beams, each at its own instant, from turns as they come."""

    _model: str
    _config: Config
    range_max_m: float | None = None

    @abstractmethod
    def _turns(self, line: Transport, stopped: Callable[[], bool]) -> Iterator[Turn]:
        """Turns as they come; the first may have begun before we listened. Raises Stopped, Unplugged, SensorTrouble."""

    def _talk(self, line: Transport, stopped: Callable[[], bool]) -> Iterator[Message]:
        turns, pace = self._turns(line, stopped), _Pace()
        pace.ended(next(turns).ended_s)
        laser: Laser | None = None
        first: list[int] = []
        for turn in turns:
            end_s = pace.ended(turn.ended_s)
            if laser is None:
                first.append(len(turn.angles_deg))
                if len(first) < FIRST_TURNS:
                    continue
                laser = self._laser(round(float(np.median(first))), pace.period_s)
            begun_s = end_s - pace.period_s
            stamp_ns = self.clock.stamp_ns(begun_s)
            self.health.saw(stamp_ns, turn.last_s - begun_s)
            ranges_m = on_beams(turn.angles_deg, turn.ranges_mm, laser.angles_rad.size)
            yield Scan(stamp_ns, clean_ranges(ranges_m, laser), laser)

    def _laser(self, beams: int, period_s: float) -> Laser:
        """Evenly spaced beams from bearing 0 on, in the order in which they are sensed: clockwise as seen from
        above, or as ``lds.clockwise`` says."""
        step = (-1.0 if self._config.lds.clockwise else 1.0) * 2.0 * math.pi / beams
        ours = {"angle_min_deg": None, "angle_step_deg": None, "turn_period_s": period_s, "stamp_at": "first"}
        sensor = self._config.sensor.model_copy(update={**ours, "interlace": 1, "reversed_beams": False})
        told = LogGeometry(beams, 0.0, step, turn_period_s=period_s, range_max_m=self.range_max_m)
        return laser_from(sensor, told, name=self._model.lower())


def on_beams(angles_deg: FloatArray, ranges_mm: FloatArray, beams: int) -> Float32Array:
    """Ranges (``beams``,), m, at even beams from bearing 0 on from points wherever they were told: between two points of
    one surface in proportion, else of the nearer one; NaN where no point is within a beam's width."""
    order = np.argsort(angles_deg, kind="stable")
    at = angles_deg[order] / 360.0 * beams
    metres = np.where(ranges_mm[order] > 0.0, ranges_mm[order] * 1e-3, np.nan)
    out = np.full(beams, np.nan)
    if len(at) < 2:
        return out.astype(np.float32)
    beam = np.arange(beams)
    after = np.clip(np.searchsorted(at, beam), 1, len(at) - 1)
    left, right = metres[after - 1], metres[after]
    share = np.clip((beam - at[after - 1]) / np.maximum(at[after] - at[after - 1], 1e-9), 0.0, 1.0)
    near = np.where(share < 0.5, left, right)
    far_off = np.minimum(np.abs(beam - at[after - 1]), np.abs(beam - at[after])) > 1.0
    with np.errstate(invalid="ignore"):
        one_surface = np.abs(left - right) < SAME_SURFACE * np.minimum(left, right)
    between: FloatArray = np.where(one_surface, left + share * (right - left), near)
    out[~far_off] = between[~far_off]
    return out.astype(np.float32)


class _Pace:
    """When turns end, and how long they take: a late arrival is the host's fault more often than the motor's."""

    def __init__(self) -> None:
        self._arrivals: deque[float] = deque(maxlen=PACE_TURNS + 1)
        self._end_s: float | None = None
        self.period_s = 0.1

    def ended(self, arrived_s: float) -> float:
        """Instant at which a turn ended whose successor's first point arrived then."""
        self._arrivals.append(arrived_s)
        if len(self._arrivals) > 1:
            self.period_s = float(np.median(np.diff(np.array(self._arrivals))))
        if self._end_s is not None:
            due_s = self._end_s + self.period_s
            late_s = arrived_s - due_s
            if 0.0 < late_s < 0.5 * self.period_s:
                arrived_s = due_s + CATCH_UP * late_s
        self._end_s = arrived_s
        return arrived_s
