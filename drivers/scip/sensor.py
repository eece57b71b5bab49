"""A Hokuyo laser as a live `Sensor`: talks, finds it again after an unplug, gives scans on the host's clock."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np

from drivers.base import SensorTrouble
from drivers.clock_sync import ClockSync, Unwrapped
from drivers.laser_models import LogGeometry, clean_ranges, laser_from
from drivers.live_sensor import LiveSensor, NoAnswer, Stopped
from drivers.scip import requests
from drivers.scip.replies import Parameters, RawScan
from drivers.scip.requests import Window
from drivers.scip.session import TICK_S, Session
from drivers.scip.status import range_code
from drivers.transport import Transport, Unplugged
from mfslam.config import Config, ScipConfig
from mfslam.types import Laser, Message, MfslamError, Scan

PACE_SCANS = 50  # scans that tell the mirror's true pace
PACE_TOLERANCE = 0.003  # less than this off the told pace is no news


@dataclass(frozen=True)
class Geometry:
    """What one session measures: the sensor's parameters and the steps asked of it."""

    told: Parameters
    window: Window

    @staticmethod
    def of(told: Parameters, settings: ScipConfig) -> Geometry:
        """The steps that are set, else all that the sensor measures."""
        first = _step(told, settings.angle_min_deg, told.first_step)
        last = _step(told, settings.angle_max_deg, told.last_step)
        if not told.first_step <= first < last <= told.last_step:
            raise MfslamError(
                f"scip.angle_min_deg, scip.angle_max_deg: this sensor measures from {_deg(told, told.first_step):.2f} "
                f"to {_deg(told, told.last_step):.2f} deg"
            )
        return Geometry(
            told, Window(first, last, settings.cluster, settings.skip_scans, settings.short_ranges)
        )

    @property
    def step_rad(self) -> float:
        return 2.0 * math.pi / self.told.steps_per_turn

    def first_beam_s(self, period_s: float, settings: ScipConfig) -> float:
        """From the instant that the sensor's timestamp marks to its first beam. Several steps merged into one
        count as their middle."""
        zero = (
            0.0 if settings.timestamp_at == "step-0" else self.told.front_step - self.told.steps_per_turn / 2
        )
        return (self._first() - zero) / self.told.steps_per_turn * period_s

    def laser(self, config: Config, period_s: float) -> Laser:
        """The laser as it is mounted; its scans are stamped at their first beam."""
        short_m = 4.095 if self.window.short else math.inf  # what two characters hold
        told = LogGeometry(
            n_beams=self.window.count,
            angle_min_rad=(self._first() - self.told.front_step) * self.step_rad,
            angle_step_rad=self.window.cluster * self.step_rad,
            turn_period_s=period_s,
            range_min_m=self.told.min_mm * 1e-3,
            range_max_m=min(self.told.max_mm * 1e-3, short_m),
        )
        # what a preset says of other drivers' stamps and geometry does not hold here
        ours = {"stamp_at": "first", "angle_min_deg": None, "angle_step_deg": None, "turn_period_s": period_s}
        sensor = config.sensor.model_copy(update={**ours, "interlace": 1, "reversed_beams": False})
        return laser_from(sensor, told, name=self.told.model.split("(")[0].strip() or "urg")

    def _first(self) -> float:
        return self.window.first_step + 0.5 * (self.window.cluster - 1)


def _step(told: Parameters, angle_deg: float | None, otherwise: int) -> int:
    return (
        otherwise if angle_deg is None else told.front_step + round(angle_deg / 360.0 * told.steps_per_turn)
    )


def _deg(told: Parameters, step: int) -> float:
    return (step - told.front_step) * 360.0 / told.steps_per_turn


class UrgSensor(LiveSensor):
    """Scans of a Hokuyo; ``address`` is a serial device or host:port. ``range_codes`` counts error codes by meaning.

    Every scan that comes with right sums is given, also one that comes while the driver and the sensor talk of
    other things: when the line was opened, when it is left.
    """

    def __init__(self, address: str, config: Config, **line: object) -> None:
        super().__init__(f"urg:{address}", address, config.scip.baud or 115200, **line)  # type: ignore[arg-type]
        self.range_codes: dict[str, int] = {}
        self._config, self._settings = config, config.scip
        self._known: _Known | None = None

    def _talk(self, line: Transport, stopped: Callable[[], bool]) -> Iterator[Message]:
        session = Session(line, self.health.errors, stopped=stopped)
        try:
            yield from self._measure(session)
        except (Stopped, Unplugged, SensorTrouble) as end:
            with suppress(Unplugged):
                if isinstance(end, SensorTrouble) and not isinstance(end, NoAnswer):
                    session.reset()
                else:
                    session.quiet()
            if self._known is not None:  # from an earlier talk where this one did not come to measure
                yield from self._scans(session.left(self._known.geometry.window), self._known)
            raise

    def _take_leave(self, line: Transport) -> None:
        line.write(requests.QUIT)  # laser off

    def _measure(self, session: Session) -> Iterator[Scan]:
        parameters = session.begin(self._settings.baud)
        self.baud = session.line.baud() or self.baud  # where it is found first after an unplug
        geometry = Geometry.of(parameters, self._settings)
        self.health.text = "waiting for the first scan"
        known = _Known(geometry, _Pace(60.0 / parameters.rpm), session.clock, session.timer)
        known.clock.least_delay_s = self._least_delay_s(geometry, known.pace.period_s, session.line.baud())
        self._known = known
        source = session.stream if self._settings.mode == "stream" else session.latest
        yield from self._scans(source(geometry.window), known)

    def _scans(self, raws: Iterable[RawScan], known: _Known) -> Iterator[Scan]:
        for raw in raws:
            device_s = known.timer(raw.timestamp_ms) * TICK_S
            if not known.clock.arrival(device_s, raw.received_s):
                self.health.errors["sensor-clock-set-anew"] += 1
                known.clock = ClockSync(TICK_S, known.clock.least_delay_s)
                known.clock.arrival(device_s, raw.received_s)
            if known.pace.saw(device_s):
                known.lasers.clear()
            self._tell_missing(known.pace, known.geometry)
            geometry, laser = replace(known.geometry, window=raw.window), known.lasers.get(raw.window)
            if laser is None:
                laser = known.lasers[raw.window] = geometry.laser(self._config, known.pace.period_s)
            # the timer rounds down
            sensed_s = known.clock.host_s(device_s + 0.5 * TICK_S)
            first_s = sensed_s + geometry.first_beam_s(known.pace.period_s, self._settings)
            self.health.saw(self.clock.stamp_ns(first_s), raw.received_s - first_s)
            yield Scan(self.clock.stamp_ns(first_s), self._ranges(raw, geometry.told, laser), laser)

    def _tell_missing(self, pace: _Pace, geometry: Geometry) -> None:
        """Scans that the line has no time for are worth a word; those that were bent have theirs."""
        errors = self.health.errors
        if not pace.missing or any(errors[kind] for kind in ("checksum", "cut", "garbage")):
            return
        wanted = PACE_SCANS - PACE_SCANS * geometry.window.skip // (1 + geometry.window.skip)
        lost = pace.missing - (PACE_SCANS - wanted)
        if lost > 0.2 * wanted and not errors["line-too-slow"]:
            errors["line-too-slow"] = 1
            self.health.advice = f"{lost} of {wanted} scans do not get through: try scip.baud=250000 or more, or scip.cluster=2"

    def _least_delay_s(self, geometry: Geometry, period_s: float, baud: int | None) -> float:
        """From step 0 to the arrival of the last byte: the turn to the last step, and the bytes' way."""
        turn_s = geometry.window.last_step / geometry.told.steps_per_turn * period_s
        return turn_s + (geometry.window.reply_bytes * 10.0 / baud if baud else 0.0)

    def _ranges(
        self, raw: RawScan, parameters: Parameters, laser: Laser
    ) -> np.ndarray[tuple[int], np.dtype[np.float32]]:
        codes = raw.values[raw.values < parameters.min_mm]
        for value, count in zip(*np.unique(codes, return_counts=True), strict=True):
            word = range_code(int(value))
            self.range_codes[word] = self.range_codes.get(word, 0) + int(count)
        millimetres = np.where(raw.values < parameters.min_mm, np.nan, raw.values)
        return clean_ranges((millimetres * 1e-3).astype(np.float32), laser)


class _Pace:
    """The mirror's true period, from the sensor's own timestamps; and how many of its scans get through."""

    def __init__(self, told_s: float) -> None:
        self.period_s = told_s
        self.missing = 0  # scans of the latest PACE_SCANS turns
        self._start_s = self._last_s = 0.0
        self._turns = self._scans = -1  # of this stretch; -1: none begun

    def saw(self, device_s: float) -> bool:
        """A scan began at ``device_s``. True where the period is found to be another than was thought."""
        step = round((device_s - self._last_s) / self.period_s)
        self._last_s = device_s
        if self._turns < 0 or not 0 < step < 20:  # the first, or a pause
            self._begin(device_s)
            return False
        self._turns, self._scans = self._turns + step, self._scans + 1
        if self._turns < PACE_SCANS:
            return False
        found_s = (device_s - self._start_s) / self._turns
        self.missing = self._turns - self._scans
        self._begin(device_s)
        if abs(found_s / self.period_s - 1.0) < PACE_TOLERANCE or not 0.8 < found_s / self.period_s < 1.25:
            return False
        self.period_s = found_s
        return True

    def _begin(self, device_s: float) -> None:
        self._start_s, self._turns, self._scans = device_s, 0, 0


@dataclass(eq=False)
class _Known:
    """What stamps the scans of one session: the sensor's geometry, its mirror's pace and its timer against the host's
    clock. ``lasers`` of this pace by window."""

    geometry: Geometry
    pace: _Pace
    clock: ClockSync
    timer: Unwrapped
    lasers: dict[Window, Laser] = field(default_factory=dict)
