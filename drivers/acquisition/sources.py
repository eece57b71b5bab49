"""What ``--lidar`` and ``--wheels`` name, and the sensors that stand behind it."""

from __future__ import annotations

import math
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Literal

from drivers.base import Sensor
from drivers.host_clock import HostClock
from drivers.transport import tcp_address
from mfslam.config import Config
from mfslam.types import MfslamError

LIDARS = "urg:DEVICE, urg:HOST:PORT, rplidar:MODEL:DEVICE, lds:MODEL:DEVICE, sim:WORLD, sim:WORLD@utm-30lx"
_SIMULATED_BOARDS: dict[str, tuple[Literal["lines", "arduino"], str]] = {
    "sim": ("lines", "board"),
    "sim:arduino": ("arduino", "arduino"),
}
WHEELS = "board:DEVICE, arduino:DEVICE, sim (with a simulated lidar), sim:arduino"


@dataclass(frozen=True)
class Sources:
    """Sensors as the user names them. Raises MfslamError for names that say nothing."""

    lidar: str | None = None
    wheels: str | None = None

    def __post_init__(self) -> None:
        if self.lidar is None and self.wheels is None:
            raise MfslamError("expected --lidar or --wheels, or both")
        for option, text, known, kinds in (
            ("--lidar", self.lidar, LIDARS, ("urg", "rplidar", "lds", "sim")),
            ("--wheels", self.wheels, WHEELS, ("board", "arduino", "sim")),
        ):
            kind, _, rest = (text or "").partition(":")
            simulated = option == "--wheels" and kind == "sim"
            good = text in _SIMULATED_BOARDS if simulated else kind in kinds and rest
            if text is not None and not good:
                raise MfslamError(f"{option} {text}: expected one of {known}")
        if self.lidar is not None and self.lidar.startswith("urg:"):
            tcp_address(self.lidar[4:])
        if self.lidar is not None and self.lidar.startswith("rplidar:"):
            _rplidar(self.lidar)
        if self._simulated_wheels and not self._simulated_lidar:
            raise MfslamError(
                f"--wheels {self.wheels}: needs the world of a simulated lidar: --lidar sim:WORLD"
            )

    @property
    def _simulated_lidar(self) -> bool:
        return self.lidar is not None and self.lidar.startswith("sim:")

    @property
    def _simulated_wheels(self) -> bool:
        return self.wheels in _SIMULATED_BOARDS

    def map_settings(self) -> list[str]:
        """What whoever maps the recording must know of a simulated robot: the geometry of its wheels."""
        if not self._simulated_wheels:
            return []
        from drivers.simulator.robot import RobotModel

        wheels = RobotModel().wheels
        return [
            f"wheels.{key}={getattr(wheels, key):g}" for key in ("radius_left_m", "radius_right_m", "track_m")
        ]

    def open(self, config: Config, clock: HostClock, stack: ExitStack) -> list[Sensor]:
        """The sensors; what plays simulated ones ends with ``stack``. Raises MfslamError."""
        lidar, wheels = self.lidar, self.wheels
        if self._simulated_lidar:
            lidar, wheels = self._simulate(config, stack)
        out: list[Sensor] = []
        if wheels is not None:
            out.append(_wheels(wheels, config, clock))
        if lidar is not None:
            out.append(_lidar(lidar, config, clock))
        for sensor, name in zip(out, [name for name in (self.wheels, self.lidar) if name], strict=True):
            sensor.health.name = name  # as the user calls it, also where it is simulated
        return out

    def _simulate(self, config: Config, stack: ExitStack) -> tuple[str, str | None]:
        """Ports of simulated sensors, named as real ones are."""
        from drivers.simulator.devices.serve import Cast, SimulatedSensors

        world, _, laser = (self.lidar or "").removeprefix("sim:").partition("@")
        sensor = config.sensor
        mount = (sensor.mount_x_m or 0.0, sensor.mount_y_m or 0.0, math.radians(sensor.mount_yaw_deg or 0.0))
        board, kind = _SIMULATED_BOARDS.get(self.wheels or "", (None, ""))
        played = stack.enter_context(SimulatedSensors(Cast(world, laser or "urg-04lx", board, mount=mount)))
        driver = f"rplidar:{laser.removeprefix('rplidar-')}" if laser.startswith("rplidar-") else "urg"
        return f"{driver}:{played.lidar}", f"{kind}:{played.board}" if board else self.wheels


def _lidar(text: str, config: Config, clock: HostClock) -> Sensor:
    kind, _, address = text.partition(":")
    if kind == "lds":
        from drivers.lds_sensor import LdsSensor

        model, colon, device = address.partition(":")
        if not colon:
            raise MfslamError(
                f"--lidar {text}: expected lds:MODEL:DEVICE; models: {', '.join(LdsSensor.models())}"
            )
        return LdsSensor(model, device, config, clock=clock)
    if kind == "rplidar":
        from drivers.rplidar.sensor import RplidarSensor

        return RplidarSensor(*_rplidar(text), config, clock=clock)
    from drivers.scip.sensor import UrgSensor

    return UrgSensor(address, config, clock=clock)


def _rplidar(text: str) -> tuple[str, str]:
    """Model and device. Raises MfslamError."""
    from drivers.rplidar.sensor import MODELS

    model, _, device = text.removeprefix("rplidar:").partition(":")
    if not device or model.upper() not in MODELS:
        raise MfslamError(f"--lidar {text}: expected rplidar:MODEL:DEVICE; models: {', '.join(MODELS)}")
    return model, device


def _wheels(text: str, config: Config, clock: HostClock) -> Sensor:
    kind, _, address = text.partition(":")
    if kind == "arduino":
        from drivers.board.arduino import ArduinoBoard

        return ArduinoBoard(address, config, clock=clock)
    from drivers.board.streaming import StreamingBoard

    return StreamingBoard(address, config, clock=clock)
