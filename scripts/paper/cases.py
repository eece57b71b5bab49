"""Maps made with one setting or another, from logs of one drive, against the truth."""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import numpy as np

from mfslam.types import FloatArray
from paper.map_error import MapError, MapPoints, map_error
from paper.rig import drive_through, run_engine, settings_of

PICTURE_POINTS = 60_000


@dataclass(frozen=True)
class Setup:
    """One way to make a map: presets and settings on top of those of the sensor and the wheels."""

    name: str
    presets: tuple[str, ...] = ()
    settings: tuple[str, ...] = ()


# ICP and wheels, nothing more; whole scans
_PAPER = ("loops.use=false", "refine.passes=0", "refine.localise=false", "icp.point_spacing_m=0")
# the closed form of the paper knows no prior: wheels so unsure that they start a match and hold nothing
_GUESS_ONLY = (
    *(
        "odometry.sigma_translation_per_m=10",
        "odometry.sigma_lateral_per_m=10",
        "odometry.sigma_rotation_per_m=10",
    ),
    *("odometry.sigma_floor_m=1", "odometry.sigma_floor_rad=1"),
)
CONVENTIONAL = Setup("conventional ICP", ("conventional-icp",), (*_PAPER, *_GUESS_ONLY))
MOTION_FREE = Setup("motion-free ICP", ("motion-free-icp",), (*_PAPER, *_GUESS_ONLY))
CONVENTIONAL_HELD = Setup("conventional ICP, wheels as prior", ("conventional-icp",), _PAPER)
MOTION_FREE_HELD = Setup("motion-free ICP, wheels as prior", ("motion-free-icp",), _PAPER)
MFSLAM = Setup("mfslam, defaults")
MAP_SETUPS = (CONVENTIONAL, MOTION_FREE, MFSLAM)
ALL_SETUPS = (CONVENTIONAL, MOTION_FREE, CONVENTIONAL_HELD, MOTION_FREE_HELD, MFSLAM)


@dataclass(frozen=True)
class Task:
    """A log to make and map: world, seed, the first seconds of the drive (None: all), and how."""

    world: str
    seed: int
    setup: Setup
    first_s: float | None = None


@dataclass(frozen=True, eq=False)
class Mapped:
    """``points_m`` (P, 2): some of the map's points in the true world's frame. ``loops``: in the graph."""

    task: Task
    error: MapError
    points_m: FloatArray
    loops: int
    cpu_s: float


def map_one(task: Task) -> Mapped:
    drive = drive_through(task.world, task.first_s)
    messages = drive.log(task.seed).messages
    settings = settings_of(*task.setup.presets, settings=task.setup.settings)
    before = os.times()
    slam, solution = run_engine(messages, settings)
    after = os.times()
    points = MapPoints.of(slam.scans, solution.world_T_reference, solution.twists, settings.deskew)
    placed = points.in_truth(drive)
    chosen = np.linspace(0, len(placed) - 1, min(len(placed), PICTURE_POINTS)).astype(np.int64)
    loops = sum(edge.kind == "loop" for edge in solution.edges)
    cpu_s = after.user + after.system - before.user - before.system
    return Mapped(task, map_error(drive, points), placed[chosen], loops, cpu_s)


def map_all(tasks: Sequence[Task], jobs: int) -> list[Mapped]:
    """All tasks, in their order, ``jobs`` at the same time."""
    if jobs == 1:
        return [map_one(task) for task in tasks]
    with ProcessPoolExecutor(jobs) as pool:
        return list(pool.map(map_one, tasks))


def mean_error(mapped: Sequence[Mapped], figure: str) -> float:
    """Root mean square of one figure of `MapError` over several maps."""
    return float(np.sqrt(np.mean([getattr(m.error, figure) ** 2 for m in mapped])))
