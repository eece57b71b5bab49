"""The world that simulated sensors share: one drive, sensed at any instant."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from drivers.laser_models import LogGeometry, laser_from
from drivers.simulator.motion import Motion
from drivers.simulator.robot import RobotModel, drive, encoder_ticks, wheel_angles
from drivers.simulator.sensing import sense
from drivers.simulator.sensors import LaserModel
from drivers.simulator.world import World
from mfslam.settings import load, preset_path
from mfslam.types import FloatArray, IntArray


@dataclass(frozen=True)
class UrgModel:
    """A Hokuyo as PP tells it, and what of that is not true; or another laser in the same words. ``nothing``: the value of
    a beam that meets nothing."""

    name: str
    preset: str
    min_mm: int
    max_mm: int
    steps_per_turn: int
    first_step: int
    last_step: int
    front_step: int
    rpm: int
    nothing: int
    clockwise: bool = False

    @property
    def period_s(self) -> float:
        return 60.0 / self.rpm


URG_MODELS = {
    "urg-04lx": UrgModel(
        "URG-04LX(Hokuyo Automatic Co.,Ltd.)", "urg-04lx", 20, 5600, 1024, 44, 725, 384, 600, 0
    ),
    "utm-30lx": UrgModel("UTM-30LX", "utm-30lx", 23, 60000, 1440, 0, 1080, 540, 2400, 65533),
}
RPLIDAR_MODELS = {
    f"rplidar-{name}": UrgModel(
        f"rplidar-{name}", f"rplidar-{preset}", 150, max_mm, points, 0, points - 1, 0, 600, 0, clockwise=True
    )
    for name, preset, max_mm, points in (
        ("a1", "a1", 12000, 200), ("a2", "a2", 16000, 200), ("a3", "a2", 25000, 400), ("s1", "a2", 40000, 400),
        ("s2", "a2", 30000, 400),
    )
}  # fmt: skip
TOO_NEAR = 7  # an error code
WHEEL_STEP_S = 0.005  # slip is drawn for so long


@dataclass
class Stage:
    """A drive through a world, which begins when the sensors are switched on and ends where the path ends."""

    world: World
    robot: RobotModel
    urg: UrgModel
    body_T_laser: FloatArray = field(default_factory=lambda: np.zeros(3))
    motor_error: float = 0.0  # the mirror's period is longer by this share
    seed: int = 0

    def __post_init__(self) -> None:
        self.motion: Motion = drive(self.world, self.robot)
        *self._rngs, wheel_rng, self._gyro_rng = np.random.default_rng(self.seed).spawn(4)
        self._times_s = np.arange(0.0, self.motion.duration_s + WHEEL_STEP_S, WHEEL_STEP_S)
        self._wheel_rad = wheel_angles(self.motion, self.robot, self._times_s, wheel_rng)
        step_rad = (-2.0 if self.urg.clockwise else 2.0) * math.pi / self.urg.steps_per_turn
        steps = self.urg.last_step - self.urg.first_step + 1
        told = LogGeometry(
            steps,
            (self.urg.first_step - self.urg.front_step) * step_rad,
            step_rad,
            turn_period_s=self.period_s,
            range_max_m=self.urg.max_mm * 1e-3,
        )
        sensor = load([preset_path(self.urg.preset)]).sensor
        mount = dict(zip(("mount_x_m", "mount_y_m"), self.body_T_laser[:2].tolist(), strict=True))
        mount["mount_yaw_deg"] = math.degrees(self.body_T_laser[2])
        sensor = sensor.model_copy(update={**mount, "turn_period_s": self.period_s, "reversed_beams": False})
        laser = laser_from(sensor, told, name=self.urg.name)
        self._laser = LaserModel(laser, self.period_s, range_step_m=0.001)

    @property
    def period_s(self) -> float:
        """True period of the mirror."""
        return self.urg.period_s * (1.0 + self.motor_error)

    def values(self, step_0_s: float) -> IntArray:
        """What the laser tells of the scan whose step 0 is at ``step_0_s``: (N,) mm or codes, of all its steps."""
        first_s = step_0_s + self.urg.first_step / self.urg.steps_per_turn * self.period_s
        scans: Iterator[np.ndarray] = sense(
            self.world, self.motion, self._laser, np.array([first_s]), *self._rngs
        )
        metres = next(scans)
        millimetres = np.rint(np.where(np.isfinite(metres), metres, 0.0) * 1e3).astype(np.int64)
        millimetres[np.isnan(metres)] = TOO_NEAR
        millimetres[np.isposinf(metres)] = self.urg.nothing
        return millimetres

    def ticks(self, at_s: float) -> tuple[int, int]:
        """Counters of the left and right wheel, slip included."""
        angles = np.array([[np.interp(at_s, self._times_s, side) for side in self._wheel_rad.T]])
        left, right = encoder_ticks(angles, self.robot.wheels)[0]
        return int(left), int(right)

    def gyro_rad_s(self, at_s: float) -> float:
        rate = float(self.motion.twist_at(at_s)[2]) * (1.0 + self.robot.gyro_scale_error)
        return (
            rate + self.robot.gyro_bias_rad_s + float(self._gyro_rng.normal(0.0, self.robot.gyro_sigma_rad_s))
        )

    def heading_rad(self, at_s: float) -> float:
        noise = float(self._gyro_rng.normal(0.0, self.robot.compass_sigma_rad or 0.0))
        return float(self.motion.at(at_s)[2]) + self.robot.compass_bias_rad + noise
