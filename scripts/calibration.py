#!/usr/bin/env python3
"""Calibration against exact truth: simulated offices of 10 minutes, every parameter assumed wrong at random.

    scripts/calibration.py --seeds 50 --rows calibration.jsonl --markdown docs/calibration.md

Each seed is one row of ``--rows``, written at once; seeds that are there already are not run again.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from benchmarking.page import replace_section
from scipy.special import chdtri

from drivers.simulator import RobotModel, Simulation, laser_model, load_world, simulate
from mfslam.calibration.outcome import Calibration
from mfslam.calibration.passes import calibrate_by_turns
from mfslam.config import Config, WheelsConfig
from mfslam.settings import load, preset_path
from mfslam.slam import Slam, Solution
from mfslam.types import Scan

NOMINAL = WheelsConfig(radius_left_m=0.08, radius_right_m=0.08, track_m=0.33, ticks_per_turn=256)
NOMINAL_MOUNT = (0.12, 0.0, 0.0)
OFFICE = "office:{seed}:10:2"  # rooms a side, laps: 10 minutes
SPEED_M_S, SLIP_M_PER_SQRT_M = 1.0, 0.003
# sigmas of what is assumed wrongly: radii and track (shares), mount (m, rad), delay (s)
RADIUS, TRACK, MOUNT_M, MOUNT_RAD, DELAY_S = 0.01, 0.03, 0.02, math.radians(1.0), 0.03
BARS = {
    "radius_left": (0.002 * 0.08, "m"), "radius_right": (0.002 * 0.08, "m"), "track": (0.005 * 0.33, "m"),
    "mount_x": (0.005, "m"), "mount_y": (0.005, "m"), "mount_yaw": (0.3, "deg"), "delay": (0.003, "s"),
    "clock_drift": (math.inf, "s/s"),
}  # fmt: skip


def simulated(seed: int) -> tuple[Simulation, dict[str, float]]:
    """A drive, and the truth of all that its log tells wrongly."""
    left, right, track, x, y, yaw, delay, _ = np.random.default_rng(1000 + seed).normal(size=8)
    robot = RobotModel(
        wheels=NOMINAL, max_speed_m_s=SPEED_M_S, odometry="ticks", slip_m_per_sqrt_m=SLIP_M_PER_SQRT_M,
        radius_error_left=RADIUS * left, radius_error_right=RADIUS * right, track_error=TRACK * track,
    )  # fmt: skip
    mount = np.array(NOMINAL_MOUNT) + np.array([MOUNT_M * x, MOUNT_M * y, MOUNT_RAD * yaw])
    laser = dataclasses.replace(laser_model("urg-04lx", mount), stamp_delay_s=DELAY_S * delay)
    truth = {
        "radius_left": NOMINAL.radius_left_m * (1.0 + RADIUS * left),
        "radius_right": NOMINAL.radius_right_m * (1.0 + RADIUS * right),
        "track": NOMINAL.track_m * (1.0 + TRACK * track),
        "mount_x": float(mount[0]), "mount_y": float(mount[1]), "mount_yaw": math.degrees(mount[2]),
        "delay": -DELAY_S * delay, "clock_drift": 0.0,
    }  # fmt: skip
    world = load_world(OFFICE.format(seed=seed), SPEED_M_S)
    return simulate(world, robot, laser, seed=seed), truth


def assumed() -> Config:
    config = load([preset_path("urg-04lx")])
    sensor = config.sensor.model_copy(
        update=dict(zip(("mount_x_m", "mount_y_m", "mount_yaw_deg"), NOMINAL_MOUNT, strict=True))
    )
    return config.model_copy(update={"wheels": NOMINAL, "sensor": sensor})


def mapped(simulation: Simulation, config: Config) -> tuple[Slam, Solution]:
    """The log, read with what the config assumes of its laser."""
    sensor, slam, true_laser = config.sensor, Slam(config), simulation.scans[0].laser
    mount = np.array([sensor.mount_x_m, sensor.mount_y_m, math.radians(sensor.mount_yaw_deg or 0.0)])
    laser = dataclasses.replace(
        true_laser, body_T_laser=mount, offsets_s=true_laser.offsets_s + sensor.transport_delay_s
    )
    for message in simulation.messages:
        slam.feed(dataclasses.replace(message, laser=laser) if isinstance(message, Scan) else message)
    return slam, slam.finish()


def row_of(seed: int) -> dict[str, Any]:
    simulation, truth = simulated(seed)
    began_s = time.process_time()
    found = calibrate_by_turns(
        lambda config: mapped(simulation, config), assumed(), lambda: False, lambda _: None
    )
    assert found is not None, f"seed {seed}: nothing found"
    return {
        "seed": seed,
        "cpu_s": round(time.process_time() - began_s, 1),
        "minutes": simulation.motion.duration_s / 60.0,
        "error": {name: found[name].value - truth[name] for name in BARS},
        "sigma": {name: found[name].sigma for name in BARS},
        "nees": nees(found, truth),
    }


def nees(found: Calibration, truth: dict[str, float]) -> float:
    """Normalised squared error of all parameters together; expected to be their number."""
    index = [n for n, e in enumerate(found.estimates) if e.name in BARS]
    off = np.array([found.estimates[n].value - truth[found.estimates[n].name] for n in index])
    return float(off @ np.linalg.solve(found.covariance[np.ix_(index, index)], off))


def table(rows: list[dict[str, Any]]) -> Iterator[str]:
    yield f"{len(rows)} seeds, {np.mean([r['cpu_s'] for r in rows]):.0f} CPU seconds each:"
    yield ""
    yield "| parameter | bar | largest error | rms error | mean error | mean sigma | rms of error / sigma |"
    yield "| --- | --- | --- | --- | --- | --- | --- |"
    for name, (bar, unit) in BARS.items():
        error, sigma = (np.array([row[key][name] for row in rows]) for key in ("error", "sigma"))
        limit = f"{bar:.2g} {unit}" if math.isfinite(bar) else "none"
        yield (
            f"| {name.replace('_', ' ')}, {unit} | {limit} | {np.abs(error).max():.2g} | "
            f"{np.sqrt(np.mean(error**2)):.2g} | {error.mean():+.2g} | {sigma.mean():.2g} | "
            f"{np.sqrt(np.mean((error / sigma) ** 2)):.2f} |"
        )
    count, every = len(BARS), [row["nees"] for row in rows]
    freedom = count * len(rows)
    low, high = chdtri(freedom, 0.975) / len(rows), chdtri(freedom, 0.025) / len(rows)
    within = np.mean(np.array(every) < chdtri(count, 0.05))
    yield ""
    yield (
        f"NEES of the {count} parameters together: mean {np.mean(every):.2f}, 95 % band {low:.2f} to {high:.2f}; "
        f"{within:.0%} of the seeds below the 95 % quantile ({chdtri(count, 0.05):.1f})."
    )


def rows_in(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seeds", type=int, default=50)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--rows", type=Path, default=Path("calibration.jsonl"))
    parser.add_argument("--markdown", type=Path, help="put the tables into this page, between its markers")
    args = parser.parse_args()
    wanted = range(args.first, args.first + args.seeds)
    done = {row["seed"] for row in rows_in(args.rows)}
    for seed in wanted:
        if seed not in done:
            with args.rows.open("a") as file:
                print(json.dumps(row_of(seed)), file=file, flush=True)
    lines = "\n".join(table([row for row in rows_in(args.rows) if row["seed"] in wanted]))
    print(lines)
    if args.markdown is not None:
        replace_section(args.markdown, "calibration", lines)


if __name__ == "__main__":
    main()
