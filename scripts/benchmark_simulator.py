#!/usr/bin/env python3
"""How fast the simulator is: beams per CPU second, of ray casting alone and of whole logs with noise and wheels.

Every figure is the best of several runs in one thread, by CPU time, after everything is compiled.

    scripts/benchmark_simulator.py
    scripts/benchmark_simulator.py --markdown docs/simulator.md
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np
from benchmarking.page import as_markdown, replace_section

from drivers.simulator import Motion, drive, laser_model, load_world, parse_world, simulate
from drivers.simulator.demo import demo_robot
from drivers.simulator.offices import random_office_text
from drivers.simulator.simulate import cast_scans
from drivers.simulator.world import World
from mfslam.types import MfslamError

LASERS = ("urg-04lx", "fast", "utm-30lx")
MOST_BEAMS = 1_500_000  # cast in one run: of long drives the beginning
HEAD = [
    "world",
    "walls",
    "drive",
    "driven in",
    "laser",
    "beams per scan",
    "rays alone, M/s",
    "whole log, M/s",
]

Result = TypeVar("Result")


def worlds() -> dict[str, World]:
    return {
        "square-aisle": load_world("square-aisle"),
        "office:7": load_world("office:7"),
        "office:7 with 8 people": parse_world(random_office_text(7, people=8), "crowd"),
        "office:1:60:3": load_world("office:1:60:3"),
    }


def timed(work: Callable[[], Result], runs: int) -> tuple[float, Result]:
    """CPU seconds of the best run, and the result."""
    best_s = float("inf")
    for _ in range(runs):
        start_s = time.process_time()
        result = work()
        best_s = min(best_s, time.process_time() - start_s)
    return best_s, result


def beginning(motion: Motion, seconds: float) -> Motion:
    knots = max(2, int(np.searchsorted(motion.times_s, seconds)))
    return Motion(motion.times_s[:knots], motion.twists[: knots - 1], motion.world_T_body[:knots])


def rows(runs: int) -> list[list[str]]:
    out = []
    robot = demo_robot()
    simulate(load_world("demo"), robot, laser_model("generic"))  # compile
    for name, world in worlds().items():
        drive_s, motion = timed(partial(drive, world, robot), runs)
        for laser_name in LASERS:
            laser = laser_model(laser_name, (0.1, 0.0, 0.0))
            beams = len(laser.laser.angles_rad)
            scans = min(MOST_BEAMS // beams, int(motion.duration_s / laser.period_s) - 2)
            instants = np.linspace(0.0, motion.duration_s - 1.0, scans)
            cast_s, _ = timed(partial(cast_scans, world, motion, laser, instants), runs)
            part = beginning(motion, scans * laser.period_s)
            whole_s, log = timed(partial(simulate, world, robot, laser, motion=part), runs)
            out.append(
                [
                    *(
                        name,
                        str(len(world.segments)),
                        f"{motion.distance_m:.0f} m, {motion.duration_s:.0f} s",
                    ),
                    *(f"{drive_s:.2f} s", laser_name, str(beams), f"{scans * beams / cast_s / 1e6:.1f}"),
                    f"{len(log.scans) * beams / whole_s / 1e6:.1f}",
                ]
            )
            print("  ".join(out[-1]), flush=True)
    return out


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=3, help="runs per figure (3)")
    parser.add_argument("--markdown", type=Path, help="put the table into this page")
    args = parser.parse_args()
    if args.runs < 1:
        parser.error(f"--runs {args.runs}: expected at least 1")
    table = rows(args.runs)
    if args.markdown is not None:
        replace_section(args.markdown, "speed", as_markdown([HEAD, *table]))
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except (MfslamError, OSError) as error:
        sys.exit(f"benchmark_simulator: {error}")
