"""`mfslam replay`: a log through the live engine, at its own pace or faster."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from drivers.base import Log
from drivers.logs import open_log
from mfslam.commands.interrupts import Interrupts
from mfslam.commands.progress import Progress
from mfslam.commands.settings import config_for, topics_of
from mfslam.commands.status_line import StatusLine
from mfslam.commands.view import place_of
from mfslam.commands.watching import Watching, open_viewer
from mfslam.live.engine import LiveSlam
from mfslam.live.intake import AHEAD_SCANS, Intake, paced
from mfslam.live.latency import switch_quickly
from mfslam.live.memory import peak_mb
from mfslam.live.state import LiveState
from mfslam.live.words import Finished
from mfslam.output import json_text, run_folder, write_atomically
from mfslam.output.growing_map import clear_growing_maps
from mfslam.output.tum import trajectory_text
from mfslam.types import MfslamError, Scan


def run(args: argparse.Namespace) -> int:
    switch_quickly()
    config = config_for(args.log, args)
    speed = speed_of(args.speed)
    progress = Progress(args.quiet)
    if not args.map_every > 0.0:
        raise MfslamError(f"--map-every {args.map_every:g}: expected more than 0 s")
    place = None if args.view is None else place_of(args)
    with (
        run_folder(args.output, args.overwrite),
        open_log(args.log, config, topics=topics_of(args)) as log,
        Interrupts() as interrupts,
        ExitStack() as stack,
    ):
        viewer = open_viewer(place, args.output, progress.tell, stack)
        slam = stack.enter_context(LiveSlam(config, args.output, args.map_every, progress.tell))
        watching = Watching(slam, StatusLine(quiet=True), args.output, viewer)
        told = replay(log, slam, speed, progress, interrupts, lambda: watching.look([]))
        watching.solving()
        finished = slam.finish(
            args.output, args.log, log.info.format, log.findings, progress.tell, lambda: interrupts.count > 1
        )
        clear_growing_maps(args.output)
        watching.show_last(slam.state())
        leave_online(args.output, finished, told, slam.state())
    if not args.quiet:
        say(finished, slam.state(), args.output)
    return 130 if interrupts.count else 0


def speed_of(text: str) -> float | None:
    """How many times faster than recorded; None: as fast as it goes. Raises MfslamError."""
    if text == "max":
        return None
    try:
        speed = float(text)
    except ValueError:
        speed = 0.0
    if not 0.0 < speed < float("inf"):
        raise MfslamError(f"--speed {text}: expected a number above 0 (1 is the pace of the log), or max")
    return speed


def replay(
    log: Log, slam: LiveSlam, speed: float | None, progress: Progress, interrupts: Interrupts,
    show: Callable[[], None],
) -> list[tuple[int, np.ndarray]]:  # fmt: skip
    """Feed a log; returns stamp and pose of every scan as it was told at its time."""
    told: list[tuple[int, np.ndarray]] = []
    slam.may_thin = speed is not None  # at full speed it is the log that waits
    intake, first_ns = Intake(slam), None
    progress.start(f"replaying {log.info.path.name}")
    for message in paced(log, speed):
        intake.put(message)
        pose = intake.take()
        if isinstance(message, Scan):
            first_ns = message.stamp_ns if first_ns is None else first_ns
            progress.update(log.progress(), (message.stamp_ns - first_ns) * 1e-9)
            if pose is not None:
                told.append((message.stamp_ns, pose))
            if speed is None:
                slam.wait(AHEAD_SCANS)
        show()
        if interrupts.count:
            break
    progress.close(complete=not interrupts.count)
    slam.wait(1)  # one scan waits for the wheels to tell the motion through it
    show()
    return told


def leave_online(
    folder: Path, finished: Finished, told: list[tuple[int, np.ndarray]], state: LiveState
) -> None:
    """What was believed on the way: ``live.tum`` (each pose as it was told), ``online.tum`` (all of them just before the
    final solve), ``live.json``."""
    assert finished.stamps_ns is not None and finished.online is not None
    stamps = np.array([stamp_ns for stamp_ns, _ in told], dtype=np.int64)
    poses = np.array([pose for _, pose in told]).reshape(-1, 3)
    write_atomically(folder / "live.tum", trajectory_text(stamps, poses).encode())
    write_atomically(folder / "online.tum", trajectory_text(finished.stamps_ns, finished.online).encode())
    assert finished.memory is not None
    held, travelled_m = finished.memory, max(float(finished.summary["distances"]["travelled_m"]), 1.0)
    memory = {
        "engine_mb": peak_mb(),
        "back_end_mapping_mb": held.mapping,
        "back_end_kb_per_m": 1024.0 * (held.mapping - held.first) / travelled_m,
        "copies_mb": held.copies,
        "back_end_mb": held.most,
    }
    figures = {
        "counts": state.counts,
        "latency_ms": state.latency_ms,
        "memory": memory,
        "notes": state.notes,
    }
    write_atomically(folder / "live.json", json_text(figures).encode())


def say(finished: Finished, state: LiveState, folder: Path) -> None:
    """What came out, and where it lies."""
    counts, latency = finished.summary["counts"], state.latency_ms
    print(
        f"{counts['scans']} scans, {counts['keyframes']} keyframes, {finished.summary['loops']['in_use']} loops"
    )
    if latency:
        print(
            f"pose of a scan after {latency['median']:.1f} ms (median), {latency['p99']:.1f} ms (99 %), "
            f"{latency['worst']:.1f} ms (worst)"
        )
    for line in [*finished.notes, *(note for note in state.notes if note not in finished.notes)]:
        print(f"note: {line}", file=sys.stderr)
    print(f"map     {folder / 'map.png'}   (map.yaml for Nav2 and map_server)")
    print(f"report  {folder / 'report.html'}")
