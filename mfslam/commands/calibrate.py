"""`mfslam calibrate`: wheels, mount and delay of a robot by its ordinary logs."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from drivers.logs import open_log
from mfslam.calibration.outcome import Calibration
from mfslam.calibration.run import applied, calibrate, together
from mfslam.commands.interrupts import Interrupts
from mfslam.commands.map_log import finish, read_log
from mfslam.commands.progress import Progress
from mfslam.commands.settings import config_for, topics_of
from mfslam.config import Config
from mfslam.kernels.warm_up import compile_once
from mfslam.output import check_writable, json_text, write_atomically
from mfslam.slam import Slam
from mfslam.types import Findings, MfslamError

PASSES = 3  # of deskewing and matching with what the pass before found


def run(args: argparse.Namespace) -> int:
    progress = Progress(args.quiet)
    if args.output.exists() and not args.overwrite:
        raise MfslamError(f"{args.output}: exists already; give --overwrite to replace it, or another -o")
    for path in (args.output, args.json):
        if path is not None:
            check_writable(path)
    compile_once(progress.tell)
    found = []
    with Interrupts() as interrupts:
        for log in args.log:
            found.append(_of_log(log, args, progress, interrupts))
            if len(args.log) > 1:
                print(f"{log}:")
                _say(found[-1])
    names = [[e.name for e in calibration.estimates] for calibration in found]
    for path, own in zip(args.log[1:], names[1:], strict=True):
        if own != names[0]:
            raise MfslamError(
                f"{path}: its wheels or clock tell other things ({', '.join(own)}) than those of {args.log[0]} "
                f"({', '.join(names[0])}): calibrate each log by itself"
            )
    result = together(found) if len(found) > 1 else found[0]
    if len(found) > 1:
        print("together:")
    _say(result)
    write_atomically(args.output, result.yaml(" ".join(path.name for path in args.log)).encode())
    if args.json is not None:
        each = {str(path): c.as_json() for path, c in zip(args.log, found, strict=True)}
        write_atomically(args.json, json_text({"together": result.as_json(), "logs": each}).encode())
    print(f"settings {args.output}   (mfslam map LOG -o OUT --config {args.output})")
    return 130 if interrupts.count else 0


def _say(calibration: Calibration) -> None:
    for line in calibration.lines():
        print(f"  {line}", file=sys.stdout)


def _without_wheels(config: Config) -> Config:
    return config.model_copy(update={"odometry": config.odometry.model_copy(update={"use": False})})


def _of_log(path: Path, args: argparse.Namespace, progress: Progress, interrupts: Interrupts) -> Calibration:
    """Map the log, calibrate, and again with what was found, until nothing changes that matters."""
    config = config_for(path, args)
    calibration: Calibration | None = None
    first: Calibration | None = None
    blind = False  # whether the wheels spoilt the first pass: then it is made by the scans alone
    for n in range(PASSES):
        slam, findings = Slam(_without_wheels(config) if blind else config), Findings()
        with open_log(path, config, topics=topics_of(args)) as log:
            read_log(log, slam, progress, interrupts, findings)
        solution = finish(slam, progress, interrupts, findings)
        latest = calibrate(slam, solution)
        if latest is None:
            if calibration is not None:
                break
            if not blind and not interrupts.count:
                blind = True
                progress.tell("the wheels do not fit what the laser sees: again by the scans alone")
                continue
            raise MfslamError(
                f"{path}: too little to calibrate by: it needs wheels that turn as the laser sees the robot turn, "
                "and half a minute of driving with turns both ways"
            )
        calibration, first = latest, first or latest
        if interrupts.count or not (latest.significant or latest.start.words) or n == PASSES - 1:
            break
        config, blind = applied(config, latest), False
    assert calibration is not None and first is not None
    return calibration.since(first)
