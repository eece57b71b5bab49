"""`mfslam map`: from a log to a folder with map, trajectory, graph and report."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from drivers.base import Log
from drivers.logs import open_log
from mfslam.calibration.settings import applied
from mfslam.commands.interrupts import Interrupts
from mfslam.commands.progress import Progress
from mfslam.commands.settings import config_for, topics_of
from mfslam.config import Config
from mfslam.kernels.warm_up import compile_once
from mfslam.outcome import Outcome, compare_deskewing, leave, outcome_of
from mfslam.output import check_writable, run_folder
from mfslam.slam import Slam, Solution
from mfslam.types import Findings, Scan

if TYPE_CHECKING:
    from mfslam.calibration.outcome import Calibration

BLUNTER_SHARE, BLUNTER_BITS = 1.005, 0.005  # of a map's cells, of its entropy: within this it is as sharp
LEFT_ALONE = (
    "every scan of this log bears the wheels' pose, put together by its recorder: a delay between them is told by nothing, "
    "and another mount only moves the point of the robot whose way is told"
)


def run(args: argparse.Namespace) -> int:
    config = config_for(args.log, args)
    progress = Progress(args.quiet)
    with run_folder(args.output, args.overwrite), open_log(args.log, config, topics=topics_of(args)) as log:
        if args.json is not None:
            check_writable(args.json)
        compile_s = compile_once(progress.tell)
        with Interrupts() as interrupts:
            start_cpu_s = args.start_cpu_s + compile_s
            if args.calibrate == "off":
                outcome = map_log(log, config, progress, interrupts, start_cpu_s)
            else:
                outcome, config = map_calibrated(log, config, progress, interrupts, start_cpu_s, args)
            leave(outcome, config, args.output, args.json)
    if not args.quiet:
        say(outcome, args.output)
    return 130 if outcome.interrupted else 0


class _Enough(Exception):
    """The user wants the map as it is now."""


def map_log(
    log: Log, config: Config, progress: Progress, interrupts: Interrupts, start_cpu_s: float
) -> Outcome:
    """Feed a whole log to the engine, solve and render. Ctrl-C ends the reading: what came until then is
    mapped; the next one ends the refinement."""
    findings = Findings()
    slam, solution = mapped(log, config, progress, interrupts, findings)
    progress.tell("drawing the map ...")
    findings.merge(log.findings)
    return outcome_of(slam, solution, config, log.info, findings, interrupts.count > 0, start_cpu_s)


def map_calibrated(
    log: Log, config: Config, progress: Progress, interrupts: Interrupts, start_cpu_s: float,
    args: argparse.Namespace,
) -> tuple[Outcome, Config]:  # fmt: skip
    """`map_log`, and once more with the mount and the delay that the first pass found, where these are surely others
    than assumed. The second pass counts unless its map is blunter; with the settings of the pass that counts."""
    findings, info = Findings(), log.info
    slam, solution = mapped(log, config, progress, interrupts, findings)
    findings.merge(log.findings)
    left_alone = slam.motion.comes_with_scans
    calibration = None if left_alone or interrupts.count else _calibrated(slam, solution)
    told: dict[str, Any] = {"left_alone": LEFT_ALONE} if left_alone else {}
    if left_alone and slam.motion.odometry.has_moved:
        progress.tell(f"not calibrated: {LEFT_ALONE}")
    what = "" if calibration is None else calibration.what_changes()
    if calibration is not None and what:
        progress.tell(f"calibrated: {what}; mapping again")
        slam.release()
        found = applied(config, calibration)
        better = Slam(found)
        with open_log(args.log, found, topics=topics_of(args)) as again:
            read_log(again, better, progress, interrupts, Findings())
        improved = finish(better, progress, interrupts, findings)
        before = compare_deskewing(slam, solution, config)["optimised"]
        after = compare_deskewing(better, improved, found)["optimised"]
        told = {"sharpness": {"before": before, "after": after}, "used": _as_sharp(after, before)}
        if told["used"]:
            slam, solution, config = better, improved, found
            findings.add("calibrated", f"calibrated by the log itself and mapped again: {what}")
        else:
            findings.add(
                "calibration-refused",
                f"the log speaks of other values than assumed, but its map gets blunter with them: {what}; the assumed "
                "ones were kept (see `mfslam calibrate`)",
            )
    progress.tell("drawing the map ...")
    outcome = outcome_of(slam, solution, config, info, findings, interrupts.count > 0, start_cpu_s)
    if calibration is not None:
        told["found"] = {e.name: e.as_json() for e in calibration.estimates}
        if calibration.range_errors is not None:
            told["range_errors"] = calibration.range_errors.as_json()
    if told:
        outcome.summary["calibration"] = told
    return outcome, config


def _calibrated(slam: Slam, solution: Solution) -> Calibration | None:
    from mfslam.calibration.run import (  # here: scipy's optimisers take long to load
        calibrate,
        calibrate_ranges,
    )

    return calibrate(slam, solution) or calibrate_ranges(slam, solution)


def _as_sharp(after: dict[str, float], before: dict[str, float]) -> bool:
    """A mount or a clock that is off by a constant hardly blurs a map, so that it need not get sharper; where it gets
    blunter, the calibration was wrong."""
    share = after["cells"] / max(before["cells"], 1)
    return share < BLUNTER_SHARE and after["entropy_bits"] < before["entropy_bits"] + BLUNTER_BITS


def mapped(
    log: Log, config: Config, progress: Progress, interrupts: Interrupts, findings: Findings
) -> tuple[Slam, Solution]:
    """The engine fed with a whole log, and its solution."""
    slam = Slam(config)
    read_log(log, slam, progress, interrupts, findings)
    return slam, finish(slam, progress, interrupts, findings)


def read_log(log: Log, slam: Slam, progress: Progress, interrupts: Interrupts, findings: Findings) -> None:
    """Feed every message, until the user cuts it short."""
    first_ns: int | None = None
    progress.start(f"mapping {log.info.path.name}")
    try:
        for message in log:
            slam.feed(message)
            if isinstance(message, Scan):
                first_ns = message.stamp_ns if first_ns is None else first_ns
                progress.update(log.progress(), (message.stamp_ns - first_ns) * 1e-9)
            if interrupts.count:
                break
    finally:
        progress.close(complete=not interrupts.count)
    if not interrupts.count:
        return
    if first_ns is None:
        raise KeyboardInterrupt  # nothing to keep
    findings.add("interrupted", f"interrupted after {log.progress():.0%} of the log: only that was mapped")
    progress.tell("interrupted: mapping what was read so far (Ctrl-C again: without refining it)")


def finish(slam: Slam, progress: Progress, interrupts: Interrupts, findings: Findings) -> Solution:
    """Solve and refine, until the user has seen enough."""
    before = interrupts.count

    def next_stage(stage: str) -> None:
        if interrupts.count > before:
            raise _Enough
        progress.tell(f"{stage} ...")

    try:
        return slam.finish(next_stage)
    except _Enough:
        findings.add("not-refined", "interrupted while refining: the map is as good as it was by then")
        progress.tell("interrupted: writing the map as it is")
        return slam.solution_so_far()


def say(outcome: Outcome, folder: Path) -> None:
    """What came out, and where it lies."""
    summary = outcome.summary
    counts, distances = summary["counts"], summary["distances"]
    loops = summary["loops"]["in_use"]
    print(
        f"{counts['scans']} scans, {distances['travelled_m']:.0f} m, {counts['keyframes']} keyframes, {loops} loops, "
        f"{summary['real_time_factor']:.0f} x real time"
    )
    for line in outcome.result.findings.lines():
        print(f"note: {line}", file=sys.stderr)
    print(f"map     {folder / 'map.png'}   (map.yaml for Nav2 and map_server)")
    print(f"report  {folder / 'report.html'}")
