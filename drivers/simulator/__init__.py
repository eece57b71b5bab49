"""An exact simulator: worlds of walls, doors, pillars, glass and people; a robot that drives through them;
encoders, gyro and laser with their faults; and the truth at every instant.

The motion is a chain of constant twists, so the pose is known in closed form at any time, and every beam
is cast from the pose at its own instant (no scan is a snapshot here either).
"""

import mfslam.kernels  # noqa: F401 (settles where compiled code is cached)
from drivers.simulator.catalog import load_world, world_names
from drivers.simulator.demo import demo_simulation
from drivers.simulator.motion import Motion
from drivers.simulator.offices import random_office
from drivers.simulator.robot import ROBOTS, RobotModel, drive
from drivers.simulator.sensing import HIT_KINDS, BeamTruth, beam_truth
from drivers.simulator.sensors import LaserModel, laser_model, laser_model_names
from drivers.simulator.simulate import Faults, Simulation, simulate, without_pose
from drivers.simulator.world import World, parse_world

__all__ = [
    "HIT_KINDS",
    "ROBOTS",
    "BeamTruth",
    "Faults",
    "LaserModel",
    "Motion",
    "RobotModel",
    "Simulation",
    "World",
    "beam_truth",
    "demo_simulation",
    "drive",
    "laser_model",
    "laser_model_names",
    "load_world",
    "parse_world",
    "random_office",
    "simulate",
    "without_pose",
    "world_names",
]
