"""Long simulated offices with exact truth, by laser, and what each part of the method is worth."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarking.pose_bound import bound_of
from benchmarking.runs import Outcome, log_name, relations_beside, run_map, say
from benchmarking.tables import Table
from drivers.simulator import Simulation, laser_model, load_world, simulate
from drivers.simulator.demo import demo_robot
from drivers.simulator.sensors import laser_preset
from mfslam.metrics import ate
from mfslam.settings import load, preset_path
from mfslam.slam import Slam

OFFICE = "office:1:8:2"  # two laps past and through 16 rooms, some 460 m
MOUNT = (0.1, 0.0, 0.0)
LASERS = ("sick-lms200", "sick-lms291", "utm-30lx", "urg-04lx", "rplidar-a2", "rplidar-a1", "generic")
ABLATED = (("office:1:8:2", "utm-30lx"), ("h-aisle", "urg-04lx"), ("hall", "generic"))

# each part of the method, without it
PARTS: dict[str, tuple[str, ...]] = {
    "all of it": (),
    "deskewing off": ("deskew.mode=none",),
    "matching with one keyframe, not 14": ("frontend.local_keyframes=1",),
    "no loops": ("loops.use=false",),
    "wheels' errors not learned": ("odometry.learn_errors=false",),
    "no wheels": ("odometry.use=false",),
    "no joint adjustment": ("refine.passes=0",),
    "one round of it": ("refine.passes=1",),
    "scans between keyframes as interpolated": ("refine.localise=false",),
    "scans thinned to 2 cm": ("icp.point_spacing_m=0.02",),
    "scans thinned to 10 cm": ("icp.point_spacing_m=0.1",),
}


@dataclass(frozen=True)
class Mapped:
    """Error against the truth of a simulated log: of all scans and of the keyframes alone."""

    travelled_m: float
    scans: int
    ate_m: float
    ate_deg: float
    keyframes_ate_m: float
    keyframes_ate_deg: float
    cpu_s: float


def make_log(world: str, laser: str) -> Simulation:
    return simulate(load_world(world), demo_robot(), laser_model(laser, MOUNT), seed=1)


def map_log(simulation: Simulation, laser: str, settings: Iterable[str] = ()) -> Mapped:
    slam = Slam(load([preset_path(laser_preset(laser))], list(settings)))
    start_s = time.process_time()
    for message in simulation.messages:
        slam.feed(message)
    solution = slam.finish()
    cpu_s = time.process_time() - start_s
    truth, found, keyframes = simulation.truth_world_T_body, solution.world_T_body, solution.keyframes
    whole, part = ate(truth, found), ate(truth[keyframes], found[keyframes])
    return Mapped(
        float(np.sum(np.hypot(*np.diff(truth[:, :2], axis=0).T))),
        len(truth),
        whole.translation_m.rmse,
        whole.rotation_deg.rmse,
        part.translation_m.rmse,
        part.rotation_deg.rmse,
        cpu_s,
    )


def simulated_table(settings: Iterable[str]) -> Table:
    """Every laser through the long office."""
    head = ["laser", "m", "scans", "ATE mm", "ATE deg", "keyframes: mm", "deg", "bound: mm", "deg", "CPU s"]
    rows = [head]
    for laser in LASERS:
        say(f"{OFFICE}, {laser}")
        log = make_log(OFFICE, laser)
        m = map_log(log, laser, settings)
        least = bound_of(load_world(OFFICE), demo_robot(), laser_model(laser, MOUNT), log)
        errors = [f"{1e3 * m.ate_m:.1f}", f"{m.ate_deg:.3f}"]
        errors += [f"{1e3 * m.keyframes_ate_m:.1f}", f"{m.keyframes_ate_deg:.3f}"]
        errors += [f"{1e3 * least.translation_m:.1f}", f"{least.rotation_deg:.3f}"]
        rows.append([laser, f"{m.travelled_m:.0f}", f"{m.scans:,}", *errors, f"{m.cpu_s:.0f}"])
    return rows


def ablation_table(logs: Iterable[Path], settings: list[str], scratch: Path) -> Table:
    """Error with one part of the method left out: simulated logs against the truth, recorded ones against their
    relations."""
    scored = [path for path in logs if relations_beside(path).is_file()]
    simulated = {(world, laser): make_log(world, laser) for world, laser in ABLATED}
    head = [
        "",
        *(f"{world}, {laser}: mm" for world, laser in ABLATED),
        *(f"{log_name(p)}: mm" for p in scored),
    ]
    head += [f"{log_name(p)}: deg" for p in scored]
    rows = [head]
    for part, without in PARTS.items():
        say(part)
        told = [*settings, *without]
        ours = [map_log(log, laser, told) for (_, laser), log in simulated.items()]
        outcomes = [run_map(path, part, told, scratch / f"{len(rows)}-{log_name(path)}") for path in scored]
        row = [part, *(f"{1e3 * m.ate_m:.1f}" for m in ours)]
        row += [_relations(o, "translation_m", 1e3, 1) for o in outcomes]
        row += [_relations(o, "rotation_deg", 1.0, 3) for o in outcomes]
        rows.append(row)
    return rows


def _relations(outcome: Outcome, figure: str, unit: float, digits: int) -> str:
    return "failed" if outcome.relations is None else f"{unit * outcome.relations[figure]['mean']:.{digits}f}"
