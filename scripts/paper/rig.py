"""What the experiments share: the paper's robot and sensor, drives through its aisles with exact truth, and
runs of the engine on their logs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from drivers.simulator import LaserModel, Motion, RobotModel, Simulation, World, drive, laser_model, simulate
from drivers.simulator import load_world as world_named
from drivers.simulator.simulate import cast_scans
from mfslam import se2
from mfslam.config import Config, WheelsConfig
from mfslam.deskew import beam_times_s, reference_offset_s
from mfslam.motion import MotionSources
from mfslam.settings import load, preset_path
from mfslam.slam import Slam, Solution
from mfslam.types import Findings, FloatArray, Message, Scan

SQUARE, H = "square-aisle", "h-aisle"
SPOKEN = {SQUARE: "square aisle", H: "H aisle"}
RANGE_MAX_M = 4.0  # as the paper has it
MOUNT = (0.1, 0.0, 0.0)  # body_T_laser: the paper tells none
WHEELS = WheelsConfig(radius_left_m=0.077, radius_right_m=0.077, track_m=0.33, ticks_per_turn=256)
RADIUS_ERRORS = (0.002, -0.001)  # left, right


def paper_robot(mirrored: bool = False) -> RobotModel:
    """Robot with 256 pulses per turn, read at 50 Hz; radii, track and grip a little off. ``mirrored``: the
    wheels' errors the other way round."""
    errors = (RADIUS_ERRORS[1], RADIUS_ERRORS[0]) if mirrored else RADIUS_ERRORS
    return RobotModel(
        wheels=WHEELS,
        max_speed_m_s=3.0,
        odometry="ticks",
        radius_error_left=errors[0],
        radius_error_right=errors[1],
        track_error=0.01,
        slip_m_per_sqrt_m=0.002,
    )


def paper_laser(noise: bool = True) -> LaserModel:
    """URG-04LX: 682 beams over 240 deg in 66.6 ms of a turn of 100 ms, 4 m; 2 cm of noise, or none."""
    model = laser_model("urg-04lx", MOUNT)
    return replace(model, laser=replace(model.laser, range_max_m=RANGE_MAX_M), noise=noise)


def settings_of(*presets: str, settings: Iterable[str] = ()) -> Config:
    """Settings of the paper's sensor and wheels, with more presets and settings on top."""
    told = [f"wheels.{key}={value}" for key, value in WHEELS.model_dump(exclude_unset=True).items()]
    files = [preset_path(name) for name in ("urg-04lx", *presets)]
    return load(files, [*told, *settings])


@dataclass(frozen=True, eq=False)
class Drive:
    """One drive of the robot through a world, and what each of its S scans of B beams truly sees.

    ``world_T_body`` (S, 3): at the scans' reference instants, which are their stamps. ``ranges_m`` (S, B),
    inf for nothing. ``points_m`` (S, B, 2): hits in the body frame at the reference instant, NaN for
    nothing. ``hits_m`` (S, B, 2): the same in the world.
    """

    world: World
    laser: LaserModel
    motion: Motion
    world_T_body: FloatArray
    instants_s: FloatArray
    ranges_m: FloatArray
    points_m: FloatArray
    hits_m: FloatArray

    def log(self, seed: int) -> Simulation:
        """The log of this drive, noise drawn from ``seed``. Every other log has the errors of left and right
        wheel the other way round: no figure is to owe its size to their sign."""
        robot = paper_robot(mirrored=seed % 2 == 0)
        return simulate(self.world, robot, self.laser, seed=seed, motion=self.motion)

    def exact_scans(self, stamps_ns: Sequence[int]) -> list[Scan]:
        """The scans without noise of the ranges."""
        nothing_is_nan = np.where(np.isfinite(self.ranges_m), self.ranges_m, np.nan).astype(np.float32)
        return [
            Scan(stamp, row, self.laser.laser) for stamp, row in zip(stamps_ns, nothing_is_nan, strict=True)
        ]


@lru_cache(maxsize=4)
def drive_through(name: str, first_s: float | None = None) -> Drive:
    """The paper's robot on the path of a shipped world, or on the ``first_s`` seconds of it."""
    world, laser, robot = world_named(name), paper_laser(), paper_robot()
    motion = drive(world, robot)
    if first_s is not None:
        last = int(np.searchsorted(motion.times_s, first_s))
        motion = Motion(motion.times_s[: last + 1], motion.twists[:last], motion.world_T_body[: last + 1])
    instants = simulate(world, replace(robot, odometry="none"), laser, motion=motion).instants_s
    ranges = cast_scans(world, motion, laser, instants)
    spec = laser.laser
    seen = np.where(np.isfinite(ranges), ranges, np.nan)
    in_laser = np.stack([seen * np.cos(spec.angles_rad), seen * np.sin(spec.angles_rad)], axis=-1)
    at_beams = se2.compose(motion.at(instants[:, None] + spec.offsets_s), spec.body_T_laser)
    hits = se2.transform(at_beams, in_laser[:, :, None, :])[:, :, 0]
    poses = motion.at(instants + reference_offset_s(spec))
    return Drive(world, laser, motion, poses, instants, ranges, se2.transform(se2.inverse(poses), hits), hits)


def true_twists(drive: Drive) -> FloatArray:
    """(S, 3) mean true body twist through each scan."""
    span_s = float(np.ptp(beam_times_s(drive.laser.laser)))
    begin = drive.instants_s + float(drive.laser.laser.offsets_s.min())
    steps = se2.between(drive.motion.at(begin), drive.motion.at(begin + span_s))
    return np.asarray(se2.log(steps) / span_s)


def wheel_twists(messages: Iterable[Message], settings: Config) -> FloatArray:
    """(S, 3) body twist through each scan as the engine takes it from the wheels."""
    sources, waiting = MotionSources(settings, Findings()), None
    twists = []
    for message in messages:
        if isinstance(message, Scan):
            if waiting is not None:  # as in the engine: the wheels after the scan tell of it too
                twists.append(sources.predict(waiting, np.zeros(3), np.zeros(3)).twist)
            waiting = message
        sources.add(message)
    assert waiting is not None
    twists.append(sources.predict(waiting, np.zeros(3), np.zeros(3)).twist)
    return np.array(twists)


def run_engine(messages: Iterable[Message], settings: Config) -> tuple[Slam, Solution]:
    slam = Slam(settings)
    for message in messages:
        slam.feed(message)
    return slam, slam.finish()


def rms(values: FloatArray) -> float:
    """Root mean square over all that is not NaN."""
    return float(np.sqrt(np.nanmean(np.square(values))))
