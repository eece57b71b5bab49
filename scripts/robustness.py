#!/usr/bin/env python3
"""What the engine bears: simulated logs with one fault each, against exact truth, as a table.

Every case drives a robot through a world, spoils its log, maps it with the default settings of its sensor
and compares with the truth and with the same drive without the fault. A case fails when its trajectory is
off by more than 0.3 m (RMS); the table says which stage lost it.

    scripts/robustness.py                                    # all cases, a table on the terminal
    scripts/robustness.py --only office --set loops.use=false
    scripts/robustness.py --markdown docs/robustness.md --json robustness.json
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
import time
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from benchmarking.page import as_markdown, replace_section
from robustness_cases import Case, all_cases

from drivers.simulator import LaserModel, Simulation, simulate, without_pose
from mfslam import se2
from mfslam.deskew import reference_offset_s
from mfslam.metrics import ate, crispness, nees, rpe
from mfslam.observability import tears
from mfslam.output import write_atomically
from mfslam.settings import load, preset_path
from mfslam.slam import Slam, Solution
from mfslam.types import Edge, FloatArray, MfslamError

FAILED_M = 0.3  # ATE, RMS
LOST_M, LOST_RAD = 0.3, 0.15  # error of one keyframe step of a front end that is lost
WRONG_LOOP_M, WRONG_LOOP_RAD = 0.5, 0.15


# --- one run -------------------------------------------------------------------------------------------


@dataclass
class Outcome:
    """One case, mapped and compared with the truth. ``blur``: occupied 5 cm cells over those that the true
    trajectory would make. ``worst_step``: the largest error of one keyframe step of the front end. ``nees``: of all poses by
    the covariances stated, the first pose aligned; ``torn``: how often the path is said to be."""

    case: str
    reference: str | None
    cpu_s: float = 0.0
    log_s: float = 0.0
    distance_m: float = 0.0
    scans: int = 0
    keyframes: int = 0
    ate_m: float = float("nan")
    ate_deg: float = float("nan")
    rpe_m: float = float("nan")
    rpe_deg: float = float("nan")
    blur: float = float("nan")
    nees: float = float("nan")
    torn: int = 0
    loops: int = 0
    wrong_loops: int = 0
    wrong_loops_kept: int = 0
    worst_step_m: float = 0.0
    worst_step_deg: float = 0.0
    worst_step_at_s: float = 0.0
    verdict: str = "good"


def make_simulation(case: Case) -> tuple[Simulation, LaserModel]:
    laser = case.laser()
    simulation = simulate(case.world(), case.robot, laser, seed=case.seed, faults=case.faults)
    if not case.odometry_in_scans:  # as from a ROS log
        simulation.messages[:] = [without_pose(m) for m in simulation.messages]
    return simulation, laser


def run_case(case: Case, settings: Iterable[str] = ()) -> Outcome:
    simulation, laser = make_simulation(case)
    start = time.process_time()
    slam = Slam(load([preset_path(case.preset)], [*case.settings, *settings]))
    for message in simulation.messages:
        slam.feed(message)
    solution = slam.finish()
    outcome = Outcome(case.name, case.reference, time.process_time() - start)
    measure(outcome, simulation, laser, slam, solution)
    return outcome


def measure(
    outcome: Outcome, simulation: Simulation, laser: LaserModel, slam: Slam, solution: Solution
) -> None:
    truth, estimate = simulation.truth_world_T_body, solution.world_T_body
    second = max(1, round(1.0 / laser.period_s))
    absolute, relative = ate(truth, estimate), rpe(truth, estimate, second)
    outcome.log_s = float(simulation.instants_s[-1] - simulation.instants_s[0])
    outcome.distance_m = simulation.motion.distance_m
    outcome.scans, outcome.keyframes = len(slam.scans), len(slam.keyframes)
    outcome.ate_m, outcome.ate_deg = absolute.translation_m.rmse, absolute.rotation_deg.rmse
    outcome.rpe_m, outcome.rpe_deg = relative.translation_m.rmse, relative.rotation_deg.rmse
    # the true pose where each scan's cloud stands: its reference instant, by the true timing of the laser
    told = slam.scans[0].laser
    hidden_s = reference_offset_s(told) - float(told.offsets_s[0] - laser.laser.offsets_s[0])
    true_keyframes = simulation.motion.at(simulation.instants_s + hidden_s)[solution.keyframes]
    outcome.nees = nees(truth, estimate, solution.covariances).mean
    outcome.torn = len(tears(solution.edges))
    outcome.blur = blur(slam, solution, true_keyframes)
    true_steps = se2.between(true_keyframes[:-1], true_keyframes[1:])
    local = np.array([k.local_T_body for k in slam.keyframes])
    off = np.abs(se2.between(true_steps, se2.between(local[:-1], local[1:])))
    if len(off):
        shift = np.hypot(off[:, 0], off[:, 1])
        worst = int(np.argmax(shift / LOST_M + off[:, 2] / LOST_RAD))
        outcome.worst_step_m, outcome.worst_step_deg = float(shift.max()), float(np.degrees(off[:, 2].max()))
        outcome.worst_step_at_s = float(simulation.instants_s[solution.keyframes[worst + 1]])
    loops = [e for e in solution.edges if e.kind == "loop"]
    # where stamps lie, a true loop ties the poses that the scans were sensed from, not those at their stamps
    wrong = [e for e in loops if is_wrong(e, truth[solution.keyframes]) and is_wrong(e, true_keyframes)]
    outcome.loops, outcome.wrong_loops = sum(e.weight >= 0.5 for e in loops), len(wrong)
    outcome.wrong_loops_kept = sum(e.weight >= 0.5 for e in wrong)
    outcome.verdict = verdict(outcome)


def blur(slam: Slam, solution: Solution, true_keyframes: FloatArray) -> float:
    """Cells that the keyframes' points hit, over those that they would hit from the true poses."""
    estimated = solution.world_T_reference[solution.keyframes]
    clouds = [k.cloud.points_m for k in slam.keyframes]
    cells = [
        crispness(
            np.concatenate([se2.transform(p, c) for p, c in zip(poses, clouds, strict=True)]), 0.05
        ).cells
        for poses in (estimated, true_keyframes)
    ]
    return cells[0] / max(1, cells[1])


def is_wrong(edge: Edge, true_keyframes: FloatArray) -> bool:
    off = se2.between(se2.between(true_keyframes[edge.i], true_keyframes[edge.j]), edge.i_T_j)
    return bool(np.hypot(off[0], off[1]) > WRONG_LOOP_M or abs(off[2]) > WRONG_LOOP_RAD)


def verdict(outcome: Outcome) -> str:
    if outcome.ate_m <= FAILED_M:
        return "good"
    if outcome.worst_step_m > LOST_M or np.radians(outcome.worst_step_deg) > LOST_RAD:
        return f"FAILED: front end lost near {outcome.worst_step_at_s:.0f} s"
    if outcome.wrong_loops_kept:
        return "FAILED: wrong loop"
    return "FAILED: drift, loops missing" if not outcome.loops else "FAILED: drift"


# --- tables --------------------------------------------------------------------------------------------

HEAD = [
    "case", "m", "ATE m", "ATE deg", "RPE m", "RPE deg", "x reference", "blur", "loops in use (wrong)", "wrong refused",
    "worst step", "NEES (tears)", "CPU s", "verdict",
]  # fmt: skip


def rows(outcomes: list[Outcome]) -> list[list[str]]:
    known = {o.case: o for o in outcomes}
    out = []
    for o in outcomes:
        reference = known.get(o.reference or "")
        ratio = f"{o.ate_m / reference.ate_m:.1f}" if reference is not None else ""
        out.append(
            [
                *(o.case, f"{o.distance_m:.0f}", f"{o.ate_m:.3f}", f"{o.ate_deg:.2f}", f"{o.rpe_m:.3f}"),
                *(f"{o.rpe_deg:.2f}", ratio, f"{o.blur:.2f}", f"{o.loops} ({o.wrong_loops_kept})"),
                *(
                    f"{o.wrong_loops - o.wrong_loops_kept}",
                    f"{o.worst_step_m:.2f} m {o.worst_step_deg:.1f} deg",
                ),
                *(
                    f"{o.nees:.2g} ({o.torn})" if o.nees < 10 else f"{o.nees:,.0f} ({o.torn})",
                    f"{o.cpu_s:.1f}",
                ),
                o.verdict,
            ]
        )
    return out


def table_text(table: list[list[str]], head: list[str]) -> str:
    widths = [max(len(row[c]) for row in [head, *table]) for c in range(len(head))]
    lines = [[cell.ljust(w) for cell, w in zip(row, widths, strict=True)] for row in [head, *table]]
    return "\n".join("  ".join(line).rstrip() for line in lines)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--only", action="append", default=[], help="cases whose name holds this word (may repeat)"
    )
    parser.add_argument("--set", action="append", default=[], dest="settings", help="stage.key=value")
    parser.add_argument("--jobs", type=int, default=1, help="cases run at the same time")
    parser.add_argument("--seed", type=int, default=None, help="another seed of all noise")
    parser.add_argument("--json", type=Path, help="write all figures there, after every case")
    parser.add_argument(
        "--resume", action="store_true", help="cases that --json holds already are not run again"
    )
    parser.add_argument("--markdown", type=Path, help="put the table into this page")
    args = parser.parse_args()
    if args.resume and args.json is None:
        parser.error("--resume: expected --json FILE of the run to go on with")
    cases = [c for c in all_cases() if not args.only or any(word in c.name for word in args.only)]
    if not cases:
        parser.error(f"no case holds any of {args.only}")
    if args.seed is not None:
        cases = [dataclasses.replace(c, seed=args.seed) for c in cases]
    known = {o.case: o for o in done_before(args.json)} if args.resume else {}
    names = [c.name for c in cases if c.name not in known]
    with ProcessPoolExecutor(args.jobs) as pool:
        for outcome in pool.map(_run_named, names, [args.settings] * len(names), [args.seed] * len(names)):
            print(f"{outcome.case}: {outcome.ate_m:.3f} m, {outcome.verdict}", file=sys.stderr, flush=True)
            known[outcome.case] = outcome
            if args.json is not None:
                write_atomically(
                    args.json, json.dumps([asdict(o) for o in known.values()], indent=1).encode()
                )
    table = rows([known[c.name] for c in cases])
    print(table_text(table, HEAD))
    if args.markdown is not None:
        replace_section(args.markdown, "robustness", as_markdown([HEAD, *table]))
    return 0


def done_before(file: Path) -> list[Outcome]:
    """The cases of an earlier run; none where it left nothing."""
    return [Outcome(**o) for o in json.loads(file.read_text(encoding="utf-8"))] if file.is_file() else []


def _run_named(name: str, settings: list[str], seed: int | None) -> Outcome:
    case = next(c for c in all_cases() if c.name == name)
    return run_case(case if seed is None else dataclasses.replace(case, seed=seed), settings)


if __name__ == "__main__":
    try:
        sys.exit(main())
    except MfslamError as error:
        sys.exit(f"robustness: {error}")
