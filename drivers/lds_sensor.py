"""Lasers that turn all the way round, of makers other than Hokuyo, through the library lds2d (extra ``lds``).

RPLIDAR A1 and C1, LDROBOT, YDLIDAR, Camsense, COIN-D4, LDS-01 and the like. They tell bearing and range of
each point and no time: a turn ends when the next one's first point arrives, and its points are spread over it.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from drivers.laser_models import LogGeometry, clean_ranges, laser_from
from drivers.live_sensor import LOOK_UP_S, LiveSensor, NoAnswer, Stopped
from drivers.transport import SerialTransport, Transport
from mfslam.config import Config
from mfslam.types import Float32Array, FloatArray, Laser, Message, MfslamError, Scan

SILENT_S = 5.0  # motors take their time
FIRST_TURNS = 5  # turns that tell the number of beams
PACE_TURNS = 11
CATCH_UP = 0.1  # of a turn's lateness that is believed
SAME_SURFACE = 0.1  # neighbouring ranges this near, relative, belong to one surface


class LdsSensor(LiveSensor):
    """Scans of a laser that lds2d knows by ``model``; ``LdsSensor.models`` names them."""

    def __init__(self, model: str, address: str, config: Config, **line: object) -> None:
        driver = _driver(model)
        super().__init__(f"lds:{model}:{address}", address, driver.DEFAULT_BAUD, **line)  # type: ignore[arg-type]
        self._model, self._config = model, config

    @staticmethod
    def models() -> list[str]:
        """Names of the lasers that need nothing but their port. Raises MfslamError without lds2d."""
        return [m for m in _library().available_models() if "_" not in m and not _needs_motor(m)]

    def _talk(self, line: Transport, stopped: Callable[[], bool]) -> Iterator[Message]:
        if isinstance(line, SerialTransport) and self._model.upper().startswith("RPLIDAR"):
            line.release_dtr()  # holds the motor of an A1 while it is set
        port = _Port(line, stopped)
        driver = _library().Lidar.open(self._model, transport=port)
        turns, pace = driver.scans(), _Pace()
        next(turns)  # begun before we listened
        pace.ended(port.received_s)
        laser: Laser | None = None
        first: list[Any] = []
        for turn in turns:
            end_s = pace.ended(port.received_s)
            if laser is None:
                first.append(turn)
                if len(first) < FIRST_TURNS:
                    continue
                laser = self._laser(round(float(np.median([len(t.points) for t in first]))), pace.period_s)
            begun_s = end_s - pace.period_s
            stamp_ns = self.clock.stamp_ns(begun_s)
            self.health.saw(stamp_ns, port.received_s - begun_s)
            yield Scan(stamp_ns, clean_ranges(on_beams(turn.points, laser), laser), laser)

    def _laser(self, beams: int, period_s: float) -> Laser:
        """Evenly spaced beams from bearing 0 on, in the order in which they are sensed: clockwise as seen from
        above, or as ``lds.clockwise`` says."""
        step = (-1.0 if self._config.lds.clockwise else 1.0) * 2.0 * math.pi / beams
        ours = {"angle_min_deg": None, "angle_step_deg": None, "turn_period_s": period_s, "stamp_at": "first"}
        sensor = self._config.sensor.model_copy(update={**ours, "interlace": 1, "reversed_beams": False})
        told = LogGeometry(beams, 0.0, step, turn_period_s=period_s)
        return laser_from(sensor, told, name=self._model.lower())

    def _take_leave(self, line: Transport) -> None:
        driver = _library().Lidar.open(self._model, transport=_Port(line, lambda: False))
        try:
            driver.stop()
        except _library().NotSupportedError:
            return


def on_beams(points: Sequence[Any], laser: Laser) -> Float32Array:
    """Ranges (N,), m, at the laser's even beams from points wherever they were told: between two points of one
    surface in proportion, else of the nearer one; NaN where no point is within a beam's width."""
    beams = laser.angles_rad.size
    at = np.array([p.angle_deg for p in points]) / 360.0 * beams
    metres = np.array([p.dist_mm for p in points]) * 1e-3
    order = np.argsort(at, kind="stable")
    at, metres = at[order], np.where(metres[order] > 0.0, metres[order], np.nan)
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


class _Port:
    """Our line as lds2d wants one. Ends its endless loops with Stopped and NoAnswer."""

    def __init__(self, line: Transport, stopped: Callable[[], bool]) -> None:
        self._line, self._stopped = line, stopped
        self.received_s = line.now_s()

    def read(self, size: int) -> bytes:
        if self._stopped():
            raise Stopped
        data = self._line.read(LOOK_UP_S)
        if data:
            self.received_s = self._line.now_s()
        elif self._line.now_s() - self.received_s > SILENT_S:
            raise NoAnswer(f"nothing comes in {SILENT_S:g} s")
        return data

    def write(self, data: bytes) -> int:
        self._line.write(data)
        return len(data)

    def reset_input(self) -> None:
        return

    def close(self) -> None:
        return


def _library() -> Any:
    try:
        import lds2d
        import lds2d.drivers
    except ImportError:
        raise MfslamError(
            "lasers named lds: need the library lds2d: pip install 'mfslam[lds]' (or pip install lds2d)"
        ) from None
    return lds2d


def _needs_motor(model: str) -> bool:
    from lds2d.core import driver_for

    return bool(driver_for(model).NEEDS_MOTOR)


def _driver(model: str) -> Any:
    known = LdsSensor.models()
    from lds2d.core import driver_for

    driver = driver_for(model)
    if driver is None:
        raise MfslamError(f"lds: no laser {model!r}; known: {', '.join(known)}")
    if driver.NEEDS_MOTOR:
        raise MfslamError(f"lds: {model}: its motor is driven by the host's pins, which mfslam does not do")
    return driver
