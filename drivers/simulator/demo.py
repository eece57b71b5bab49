"""The demo: a fast robot in a few rooms, so that a snapshot map is visibly wrong."""

from __future__ import annotations

from drivers.simulator.catalog import load_world
from drivers.simulator.robot import RobotModel
from drivers.simulator.sensors import laser_model
from drivers.simulator.simulate import Simulation, simulate
from mfslam.config import WheelsConfig


def demo_robot() -> RobotModel:
    """Up to 3 m/s and 2 rad/s; odometry 3 % too long in scale, drifting about half a degree per metre."""
    return RobotModel(
        wheels=WheelsConfig(radius_left_m=0.08, radius_right_m=0.08, track_m=0.35, ticks_per_turn=1024),
        max_speed_m_s=3.0,
        max_yaw_rate_rad_s=2.0,
        radius_error_left=-0.0312,
        radius_error_right=-0.0284,
        track_error=0.02,
        slip_m_per_sqrt_m=0.004,
    )


def demo_simulation(seed: int = 1) -> Simulation:
    """About 80 s of log: a 10 Hz laser of 270 deg and 10 m range, odometry at 50 Hz, exact truth."""
    return simulate(load_world("demo"), demo_robot(), laser_model("fast", (0.1, 0.0, 0.0)), seed=seed)
