"""`mfslam map`: from a log to a folder with map, trajectory, graph and report."""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.base import Log
from drivers.logs import open_log
from mfslam.commands.progress import Progress
from mfslam.commands.settings import config_for, topics_of
from mfslam.config import Config
from mfslam.kernels.warm_up import compile_once
from mfslam.mapping import render_map
from mfslam.output import json_text, prepare_folder, summarise, write_atomically, write_run
from mfslam.slam import Slam, Solution
from mfslam.types import Findings, RunResult, Scan


def run(args: argparse.Namespace) -> int:
    prepare_folder(args.output, args.overwrite)
    config = config_for(args.log, args)
    progress = Progress(args.quiet)
    compile_once(progress.tell)
    with open_log(args.log, config, topics=topics_of(args)) as log:
        outcome = map_log(log, config, progress)
    leave(outcome, config, args.output, args.json, args.quiet)
    return 130 if outcome.interrupted else 0


@dataclass
class Outcome:
    """A finished run: the result, and whether it was cut short."""

    result: RunResult
    interrupted: bool


def map_log(log: Log, config: Config, progress: Progress) -> Outcome:
    """Feed a whole log to the engine, solve and render. Ctrl-C ends the reading: what came until then is
    mapped; a second one ends the refinement."""
    start_s = time.process_time()
    slam = Slam(config)
    interrupted = read_log(log, slam, progress)
    try:
        solution = slam.finish(lambda stage: progress.tell(f"{stage} ..."))
    except KeyboardInterrupt:
        interrupted = True
        solution = slam.solution_so_far()
    progress.tell("drawing the map ...")
    with slam.clock.time("map"):
        grid, points = render_map(slam.scans, solution.world_T_reference, solution.twists, config)
    findings = Findings()
    findings.merge(log.findings)
    findings.merge(slam.findings)
    result = RunResult(
        solution.stamps_ns, solution.world_T_body, solution.keyframes, solution.edges, grid, points, findings
    )
    result.summary = run_summary(log, slam, solution, interrupted, time.process_time() - start_s)
    return Outcome(result, interrupted)


def read_log(log: Log, slam: Slam, progress: Progress) -> bool:
    """Feed every message; True when the user cut it short."""
    first_ns: int | None = None
    progress.start(f"mapping {log.info.path.name}")
    try:
        for message in log:
            slam.feed(message)
            if isinstance(message, Scan):
                first_ns = message.stamp_ns if first_ns is None else first_ns
                progress.update(log.progress(), (message.stamp_ns - first_ns) * 1e-9)
    except KeyboardInterrupt:
        progress.tell("interrupted: mapping what was read so far (again to stop refining)")
        return True
    finally:
        progress.close()
    return False


def run_summary(log: Log, slam: Slam, solution: Solution, interrupted: bool, cpu_s: float) -> dict[str, Any]:
    """What only the run knows; `mfslam.output.summarise` adds counts, distances and residuals."""
    statistics = slam.loops.statistics
    stamps = solution.stamps_ns
    log_s = float(stamps.max() - stamps.min()) * 1e-9
    return {
        "log": {"path": str(log.info.path), "format": log.info.format},
        "interrupted": interrupted,
        "real_time_factor": log_s / max(cpu_s, 1e-9),
        "timings_s": {**slam.clock.seconds, "total": cpu_s},
        "loops": {
            "searches": statistics.searches,
            "places_tried": statistics.places_tried,
            "accepted": statistics.accepted,
            "refused": dict(sorted(statistics.refused.items())),
        },
        "searched_fits": sum(step.searched for step in slam.steps),
        "odometry_anomalies": [
            {"scan": n, "stamp_s": slam.scans[n].stamp_ns * 1e-9} for n in slam.odometry_jumps
        ],
        "weak_directions": slam.weak_directions(solution.edges),
    }


def leave(outcome: Outcome, config: Config, folder: Path, json_file: Path | None, quiet: bool) -> None:
    """Write the folder, then say where things are."""
    result = outcome.result
    write_run(result, config, folder)
    summary = summarise(result)
    if json_file is not None:
        write_atomically(json_file, json_text(summary).encode())
    if quiet:
        return
    counts, distances = summary["counts"], summary["distances"]
    loops = summary["edges"].get("loop", {"count": 0})["count"]
    print(
        f"{counts['scans']} scans, {distances['travelled_m']:.0f} m, {counts['keyframes']} keyframes, {loops} loops, "
        f"{summary['real_time_factor']:.0f} x real time"
    )
    for line in result.findings.lines():
        print(f"note: {line}", file=sys.stderr)
    print(f"map     {folder / 'map.png'}   (map.yaml for Nav2 and map_server)")
    print(f"report  {folder / 'report.html'}")
