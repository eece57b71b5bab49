"""An RPLIDAR as a live `Sensor`: found at its bit rate, its motor started, its points brought into turns."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from drivers.base import SensorTrouble
from drivers.live_sensor import LOOK_UP_S, NoAnswer, Stopped
from drivers.rplidar import protocol
from drivers.rplidar.protocol import POINT_BYTES, Info, PointParser, Points, request
from drivers.transport import SerialTransport, Transport
from drivers.turning_laser import Turn, TurningLaser
from mfslam.config import Config
from mfslam.types import FloatArray, MfslamError

ANSWER_S, TRIES = 0.5, 3
SILENT_S = 5.0  # motors take their time
QUIET_S = 0.03  # without a byte: it has stopped
BOOT_S = 2.0
RPM, PWM = 600, 660  # ten turns a second; the adapter's own default
BROKEN = 2  # health
BENT_DEG = 10.0  # a point this far from its neighbours, which are near each other, has a flipped bit


@dataclass(frozen=True)
class Model:
    """Bit rates by which it is known, the likeliest first, and how far it sees (m)."""

    bauds: tuple[int, ...]
    range_max_m: float


MODELS = {
    "A1": Model((115200,), 12.0),
    "A2": Model((115200, 256000), 16.0),
    "A3": Model((256000,), 25.0),
    "C1": Model((460800,), 12.0),
    "S1": Model((256000,), 40.0),
    "S2": Model((1_000_000,), 30.0),
    "S3": Model((1_000_000,), 40.0),
}


class RplidarSensor(TurningLaser):
    """Scans of an RPLIDAR of a ``model`` of `MODELS`. Raises MfslamError for another."""

    def __init__(self, model: str, address: str, config: Config, **line: object) -> None:
        known = MODELS.get(model.upper())
        if known is None:
            raise MfslamError(f"rplidar: no model {model!r}; known: {', '.join(MODELS)}")
        super().__init__(f"rplidar:{model}:{address}", address, known.bauds[0], **line)  # type: ignore[arg-type]
        self._model, self._config, self._bauds = f"rplidar-{model.lower()}", config, known.bauds
        self.range_max_m = known.range_max_m
        self._motor_off = b""
        self.info: Info | None = None

    def _turns(self, line: Transport, stopped: Callable[[], bool]) -> Iterator[Turn]:
        talk = _Talk(line, stopped)
        if isinstance(line, SerialTransport):
            line.release_dtr()  # holds the motor while it is set, where the adapter drives it
        self.info = self._find(talk)
        talk.check_health()
        self._start_motor(talk, self.info)
        self.health.text = "waiting for the first turn"
        begun = talk.ask(protocol.SCAN, protocol.SCAN_ANSWER)
        turns, parser, bent = _Turns(), PointParser(), 0
        turned_s = line.now_s()
        for chunk, received_s in talk.listen(begun):
            for turn in turns.feed(parser.feed(chunk), received_s):
                turned_s = received_s
                yield turn
            if received_s - turned_s > SILENT_S:
                raise NoAnswer("the motor does not turn")
            bent, before = parser.bent + turns.bent, bent
            self.health.errors["bent"] += bent - before

    def _find(self, talk: _Talk) -> Info:
        """What it is, at the bit rate at which it answers. Raises NoAnswer."""
        now = talk.line.baud()
        for baud in self._bauds:
            if now is not None:
                talk.line.set_baud(baud)
            talk.quiet()
            try:
                payload = talk.ask(protocol.INFO, protocol.INFO_ANSWER)
            except NoAnswer:
                continue
            self.baud = baud
            return Info.of(payload)
        tried = f" (tried {', '.join(map(str, self._bauds))} baud)" if now is not None else ""
        raise NoAnswer(f"no RPLIDAR answers{tried}")

    def _start_motor(self, talk: _Talk, info: Info) -> None:
        """The newer ones have a speed of their own; an A2 or A3 is driven by its adapter, if that can; an A1 by DTR."""
        if info.series >= 4:
            on, off = (request(protocol.MOTOR_RPM, struct.pack("<H", rpm)) for rpm in (RPM, 0))
        elif info.series >= 2 and talk.adapter_has_pwm():
            on, off = (request(protocol.MOTOR_PWM, struct.pack("<H", pwm)) for pwm in (PWM, 0))
        else:
            on = off = b""
        self._motor_off = off
        if on:
            talk.line.write(on)

    def _take_leave(self, line: Transport) -> None:
        line.write(request(protocol.STOP) + self._motor_off)


@dataclass
class _Talk:
    """Questions and answers over an open line."""

    line: Transport
    stopped: Callable[[], bool]

    def quiet(self) -> None:
        """Stop whatever it is still sending, and throw that away."""
        self.line.write(request(protocol.STOP))
        until_s = self.line.now_s() + ANSWER_S
        while self.line.now_s() < until_s and self.line.read(QUIET_S):
            continue

    def ask(self, command: int, kind: int, payload: bytes = b"") -> bytes:
        """The payload of the answer; of a scan what has come after its begin. Raises NoAnswer, Stopped."""
        for _ in range(TRIES):
            self.line.write(request(command, payload))
            until_s, data = self.line.now_s() + ANSWER_S, b""
            while (left_s := until_s - self.line.now_s()) > 0.0:
                if self.stopped():
                    raise Stopped
                data += self.line.read(min(left_s, LOOK_UP_S))
                answer = protocol.answer_in(data, kind)
                if answer is not None:
                    return answer
        raise NoAnswer(f"no answer to command 0x{command:02X}")

    def check_health(self) -> None:
        """Reset a sensor that has stopped to protect itself. Raises SensorTrouble where that does not help."""
        for _ in range(2):
            status, error = struct.unpack("<BH", self.ask(protocol.HEALTH, protocol.HEALTH_ANSWER))
            if status != BROKEN:
                return
            self.line.write(request(protocol.RESET))
            until_s = self.line.now_s() + BOOT_S
            while self.line.now_s() < until_s:  # it tells of itself in words
                self.line.read(LOOK_UP_S)
        raise SensorTrouble(f"the sensor says that it is broken (error {error})")

    def adapter_has_pwm(self) -> bool:
        try:
            flags = self.ask(protocol.ADAPTER_FLAGS, protocol.ADAPTER_ANSWER, bytes(4))
        except NoAnswer:
            return False
        return bool(flags[0] & 1)

    def listen(self, begun: bytes) -> Iterator[tuple[bytes, float]]:
        """Bytes as they come, and when. Raises NoAnswer when nothing does."""
        received_s = self.line.now_s()
        yield begun, received_s
        while True:
            if self.stopped():
                raise Stopped
            chunk = self.line.read(LOOK_UP_S)
            if chunk:
                received_s = self.line.now_s()
                yield chunk, received_s
            elif self.line.now_s() - received_s > SILENT_S:
                raise NoAnswer(f"nothing comes in {SILENT_S:g} s")


class _Turns:
    """Points into turns. A new one begins where bearings start over, not with the flag that a point may bear: of a flag
    that is lost nothing depends then. ``bent`` counts points whose bearing cannot be."""

    def __init__(self) -> None:
        self.bent = 0
        self._point_s = 0.0  # from point to point, once it is known
        self._begun_s: float | None = None
        self._seen_half = False
        self._angles: list[FloatArray] = []
        self._ranges: list[FloatArray] = []
        self._waiting = np.zeros((3, 0))  # the last two points: the later wait for their neighbour

    def feed(self, points: Points, received_s: float) -> Iterator[Turn]:
        # packets are sent when they are full: what came in one was measured one after the other
        at_s = received_s - points.after / POINT_BYTES * self._point_s
        new = np.stack([points.angles_deg, points.ranges_mm, at_s])
        all_points = np.concatenate([self._waiting, new], axis=1)
        if all_points.shape[1] < 3:
            self._waiting = all_points
            return
        known, self._waiting = all_points[:, 1:-1], all_points[:, -2:]
        strays = _strays(all_points[0])
        self.bent += int(strays.sum())
        yield from self._split(known[:, ~strays], received_s)

    def _split(self, points: FloatArray, received_s: float) -> Iterator[Turn]:
        angles = points[0]
        begin = 0
        for k in np.flatnonzero((angles < 90.0) | (np.abs(angles - 180.0) < 90.0)).tolist():
            if angles[k] >= 90.0:
                self._seen_half = True
            elif self._seen_half:
                self._take(points[:, begin:k])
                yield from self._close(float(points[2, k]), received_s)
                begin = k
        self._take(points[:, begin:])

    def _take(self, points: FloatArray) -> None:
        self._angles.append(points[0])
        self._ranges.append(points[1])

    def _close(self, ended_s: float, last_s: float) -> Iterator[Turn]:
        angles, ranges = np.concatenate(self._angles), np.concatenate(self._ranges)
        self._angles, self._ranges, self._seen_half = [], [], False
        if self._begun_s is not None and len(angles):
            self._point_s = (ended_s - self._begun_s) / len(angles)
        self._begun_s = ended_s
        yield Turn(angles, ranges, ended_s, last_s)


def _strays(angles_deg: FloatArray) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """(N - 2,) of each inner one whether it is far from both neighbours, which are near each other."""

    def far(a: FloatArray, b: FloatArray) -> FloatArray:
        return np.abs((a - b + 180.0) % 360.0 - 180.0)

    before, here, after = angles_deg[:-2], angles_deg[1:-1], angles_deg[2:]
    return np.asarray(
        (far(here, before) > BENT_DEG) & (far(here, after) > BENT_DEG) & (far(before, after) < BENT_DEG)
    )
