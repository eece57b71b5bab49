#!/usr/bin/env python3
"""How good maps are where the truth is known: walls, ghosts, thickness, free space, glass, people.

    scripts/map_quality.py                        # all cases, a few CPU minutes
    scripts/map_quality.py --only glass --resolution 0.02 --pictures pictures/
    scripts/map_quality.py --markdown docs/map-quality.md

Each case is a simulated log with exact truth, mapped twice: from the true poses, which shows what drawing the map alone does,
and from those that mfslam finds. Walls are turned against the cells' rows by 20 deg. In a picture red is true surface without
a cell, light blue true glass without one, blue a cell without a surface, green free space that no beam came near.
"""

from __future__ import annotations

import argparse
import dataclasses
import io
import json
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from benchmarking.page import write_markdown
from map_truth import Quality, Truth, measure_map, picture, true_surfaces
from PIL import Image

from drivers.simulator.offices import random_office_text
from drivers.simulator.robot import RobotModel
from drivers.simulator.sensing import beam_truth
from drivers.simulator.sensors import laser_model, laser_preset
from drivers.simulator.simulate import Simulation, simulate
from drivers.simulator.world import parse_world
from mfslam import metrics, se2
from mfslam.config import Config
from mfslam.deskew import reference_offset_s
from mfslam.mapping import render_map
from mfslam.output.staging import write_atomically
from mfslam.settings import load, preset_path
from mfslam.slam import Slam
from mfslam.types import FloatArray, MfslamError, OccupancyGrid, Scan

MARKER = "map-quality"
LASERS = ("sick-lms200", "sick-lms291", "utm-30lx", "urg-04lx", "rplidar-a2", "rplidar-a1")
TURN_RAD = np.radians(20.0)
MIXED_SHARE = 0.3  # of edges at which a beam tells a range between the two surfaces

GLASS_FRONTS = """
# corridor with a glass front, a hall with a window, a screen of glass and a wall of 10 cm; three people walk
wall 3 0 0 0 0 2.4 6 2.4 6 9 8 9
glass 3 0 9 0
wall 9 0 20 0 20 2.4 14 2.4 14 9 12 9
wall 3 0 3 -3.5 9 -3.5 9 0
box 5 -3.1 1.2 0.7
pillar 7.5 -2 0.15
wall 7.4 2.4 12 2.4 12 2.5 7.4 2.5 7.4 2.4
glass 8 9 12 9
wall 4 13 16 13
box 10 6 1.4 0.8 20
pillar 8 5 0.2
glass 12.8 5 12.8 8
person 0.2 0.9 1 0.5 19 0.5
person 0.2 0.7 6.6 3 6.6 8 13.4 8.4
person 0.2 0.8 3.5 -1 8.5 -2.6
path 1 1.2
path 18 1.2
path 13 1.2
path 13 4.2
path 12 7.5
path 7 7.6
path 6.8 4
path 6.8 1.2
path 1.5 1.2
path 2 1.6
path 18.5 1.6
path 18.5 1
path 13 0.8
path 12.9 3.5
path 9.5 3.6
path 9.4 8.2
path 11.5 8.2
path 11.6 4
path 13 3
path 12.9 1.2
path 1 1.2
"""
WORLDS = {"office, 4 people": random_office_text(7, 4, people=4), "glass fronts, 3 people": GLASS_FRONTS}


@dataclass(frozen=True)
class Case:
    """A world seen by a laser."""

    world: str
    laser: str

    @property
    def name(self) -> str:
        return f"{self.world}, {self.laser}"


@dataclass(frozen=True, eq=False)
class Log:
    """A simulated log: its scans, and the poses at their reference instants and twists through them, true and as mapped."""

    scans: list[Scan]
    config: Config
    true: tuple[FloatArray, FloatArray]
    mapped: tuple[FloatArray, FloatArray]


def run_case(
    case: Case, resolutions_m: list[float], pictures: Path | None
) -> Iterator[tuple[float, str, Quality]]:
    """Resolution, poses used, and quality of each map."""
    laser = dataclasses.replace(laser_model(case.laser, (0.1, 0.0, 0.0)), mixed_share=MIXED_SHARE)
    world = parse_world(WORLDS[case.world], case.world)
    simulation = simulate(world, RobotModel(), laser, seed=3)
    beams = beam_truth(world, simulation.motion, laser, simulation.instants_s)
    log = map_log(simulation, load([preset_path(laser_preset(case.laser))]))
    for resolution_m in resolutions_m:
        truth = true_surfaces(world, beams, laser.laser.angles_rad, 0.5 * resolution_m, TURN_RAD)
        for poses, (world_T_body, twists) in {"true": log.true, "mapped": log.mapped}.items():
            grid = draw(log, world_T_body, twists, resolution_m)
            yield resolution_m, poses, measure_map(grid, truth)
            if pictures is not None:
                save_picture(grid, truth, pictures / f"{slug(case)}-{resolution_m:g}-{poses}.png")


def map_log(simulation: Simulation, config: Config) -> Log:
    """The log through the engine; its trajectory laid on the true one."""
    slam = Slam(config)
    for message in simulation.messages:
        slam.feed(message)
    solution = slam.finish()
    offsets_s = slam.scans[0].laser.offsets_s
    first_s, span_s = float(offsets_s.min()), max(0.01, float(np.ptp(offsets_s)))
    motion, instants = simulation.motion, simulation.instants_s
    begin = motion.at(instants + first_s)
    true_twists = se2.log(se2.between(begin, motion.at(instants + first_s + span_s))) / span_s
    true_poses = motion.at(instants + reference_offset_s(slam.scans[0].laser))
    truth_T_world = metrics.align(true_poses, solution.world_T_reference)
    mapped = se2.compose(truth_T_world, solution.world_T_reference)
    return Log(slam.scans, config, (true_poses, true_twists), (mapped, solution.twists))


def draw(log: Log, world_T_body: FloatArray, twists: FloatArray, resolution_m: float) -> OccupancyGrid:
    turned = se2.compose(np.array([0.0, 0.0, TURN_RAD]), world_T_body)
    at_resolution = log.config.map.model_copy(update={"resolution_m": resolution_m})
    return render_map(log.scans, turned, twists, log.config.model_copy(update={"map": at_resolution}))[0]


def slug(case: Case) -> str:
    return f"{case.world.split(',')[0].replace(' ', '-')}-{case.laser}"


def save_picture(grid: OccupancyGrid, truth: Truth, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    out = io.BytesIO()
    Image.fromarray(picture(grid, truth)).quantize(16).save(out, format="PNG")
    write_atomically(path, out.getvalue())


# --- table ---------------------------------------------------------------------------------------------

COLUMNS = {
    "walls found, %": "found", "glass found, %": "glass_found", "ghosts, %": "ghosts", "cells across": "thickness_cells",
    "one cell, %": "one_cell", "free to the wall, %": "free_to_wall", "leaks, %": "leaks", "free in error, %": "false_free",
    "unfilled, %": "unfilled", "off the truth, mm": "error_m",
}  # fmt: skip


def row_of(case: Case, resolution_m: float, poses: str, quality: Quality) -> list[str]:
    values = [case.world, case.laser, f"{100 * resolution_m:g} cm", poses]
    for field in COLUMNS.values():
        value = getattr(quality, field)
        if not np.isfinite(value):
            values.append("")
        elif field == "thickness_cells":
            values.append(f"{value:.3f}")
        else:
            values.append(f"{1000 * value:.1f}" if field == "error_m" else f"{100 * value:.2f}")
    return values


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", action="append", default=[], help="cases that hold this word (may repeat)")
    parser.add_argument("--resolution", action="append", type=float, help="cell size, m (0.05 and 0.02)")
    parser.add_argument("--pictures", type=Path, help="put pictures into this folder")
    parser.add_argument("--markdown", type=Path, help="put the table into this page")
    parser.add_argument("--json", type=Path, help="write all figures there")
    args = parser.parse_args()
    cases = [Case(world, laser) for world in WORLDS for laser in LASERS]
    cases = [case for case in cases if not args.only or any(word in case.name for word in args.only)]
    if not cases:
        parser.error(f"no case holds any of {args.only}")
    rows, figures = [], []
    for case in cases:
        for resolution_m, poses, quality in run_case(case, args.resolution or [0.05, 0.02], args.pictures):
            rows.append(row_of(case, resolution_m, poses, quality))
            figures.append([case.name, resolution_m, poses, dataclasses.asdict(quality)])
            print(" | ".join(rows[-1]), flush=True)
    if args.json is not None:
        write_atomically(args.json, json.dumps(figures, indent=1).encode())
    if args.markdown is not None:
        head = ["world", "laser", "cells", "poses", *COLUMNS]
        command = "scripts/map_quality.py --markdown docs/map-quality.md"
        write_markdown(args.markdown, [("Against the truth", [head, *rows])], command, MARKER)
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except MfslamError as error:
        sys.exit(f"map_quality: {error}")
