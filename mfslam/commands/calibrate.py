"""`mfslam calibrate`: wheels, mount and delay of a robot by its ordinary logs."""

from __future__ import annotations

import argparse
from pathlib import Path

from drivers.logs import open_log
from mfslam.calibration.outcome import Calibration
from mfslam.calibration.passes import calibrate_by_turns
from mfslam.calibration.run import LEAST_WINDOWS, together
from mfslam.calibration.settings import yaml_of
from mfslam.commands.interrupts import Interrupts
from mfslam.commands.map_log import mapped
from mfslam.commands.progress import Progress
from mfslam.commands.settings import config_for, topics_of
from mfslam.config import Config
from mfslam.kernels.warm_up import compile_once
from mfslam.output import check_writable, json_text, write_atomically
from mfslam.slam import Slam, Solution
from mfslam.types import Findings, MfslamError


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
    write_atomically(args.output, yaml_of(result, " ".join(path.name for path in args.log)).encode())
    if args.json is not None:
        each = {str(path): c.as_json() for path, c in zip(args.log, found, strict=True)}
        write_atomically(args.json, json_text({"together": result.as_json(), "logs": each}).encode())
    print(f"settings {args.output}   (mfslam map LOG -o OUT --config {args.output})")
    return 130 if interrupts.count else 0


def _say(calibration: Calibration) -> None:
    for line in calibration.lines():
        print(f"  {line}")


def _of_log(path: Path, args: argparse.Namespace, progress: Progress, interrupts: Interrupts) -> Calibration:
    why = "the robot hardly moves or turns in it, or its wheels tell of other turns than its laser"

    def mapped_with(config: Config) -> tuple[Slam, Solution]:
        with open_log(path, config, topics=topics_of(args)) as log:
            slam, solution = mapped(log, config, progress, interrupts, Findings())
        nonlocal why
        if not slam.motion.odometry.has_moved:
            why = "no wheels in it that turn"
        elif len(slam.scans) < LEAST_WINDOWS:
            why = f"only {len(slam.scans)} scans"
        return slam, solution

    calibration = calibrate_by_turns(
        mapped_with, config_for(path, args), lambda: bool(interrupts.count), progress.tell
    )
    if calibration is None:
        raise MfslamError(
            f"{path}: too little to calibrate by: {why}; it needs wheels, a laser, and half a minute of driving with "
            "turns both ways"
        )
    return calibration
