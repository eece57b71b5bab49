"""Lasers that turn all the way round, of makers other than Hokuyo, through the library lds2d (extra ``lds``).

RPLIDAR A1 and C1, LDROBOT, YDLIDAR, Camsense, COIN-D4, LDS-01 and the like.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from drivers.live_sensor import LOOK_UP_S, NoAnswer, Stopped
from drivers.transport import SerialTransport, Transport
from drivers.turning_laser import Turn, TurningLaser
from mfslam.config import Config
from mfslam.types import MfslamError

SILENT_S = 5.0  # motors take their time


class LdsSensor(TurningLaser):
    """Scans of a laser that lds2d knows by ``model``; ``LdsSensor.models`` names them."""

    def __init__(self, model: str, address: str, config: Config, **line: object) -> None:
        driver = _driver(model)
        super().__init__(f"lds:{model}:{address}", address, driver.DEFAULT_BAUD, **line)  # type: ignore[arg-type]
        self._model, self._config = model, config

    @staticmethod
    def models() -> list[str]:
        """Names of the lasers that need nothing but their port. Raises MfslamError without lds2d."""
        return [m for m in _library().available_models() if "_" not in m and not _needs_motor(m)]

    def _turns(self, line: Transport, stopped: Callable[[], bool]) -> Iterator[Turn]:
        if isinstance(line, SerialTransport) and self._model.upper().startswith("RPLIDAR"):
            line.release_dtr()  # holds the motor of an A1 while it is set
        port = _Port(line, stopped)
        for turn in _library().Lidar.open(self._model, transport=port).scans():
            points = np.array([(p.angle_deg, p.dist_mm) for p in turn.points], dtype=np.float64).reshape(
                -1, 2
            )
            yield Turn(points[:, 0], points[:, 1], port.received_s, port.received_s)

    def _take_leave(self, line: Transport) -> None:
        driver = _library().Lidar.open(self._model, transport=_Port(line, lambda: False))
        try:
            driver.stop()
        except _library().NotSupportedError:
            return


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
        raise MfslamError(
            f"lds: no laser {model!r}; known: {', '.join(known)} (other RPLIDARs: rplidar:MODEL:DEVICE)"
        )
    if driver.NEEDS_MOTOR:
        raise MfslamError(f"lds: {model}: its motor is driven by the host's pins, which mfslam does not do")
    return driver
