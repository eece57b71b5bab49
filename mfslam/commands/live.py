"""`mfslam live`: from live sensors to a map that grows while the robot drives, and to a recording."""

from __future__ import annotations

import argparse
import os
import signal
import sys
import time
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path

from drivers.acquisition.feed import AcquisitionFeed
from drivers.acquisition.sources import Sources
from mfslam.commands.map_log import say
from mfslam.commands.sensors import config_of, map_command, sources_of
from mfslam.commands.status_line import Ends, StatusLine
from mfslam.commands.view import place_of
from mfslam.commands.watching import Watching, open_viewer
from mfslam.config import Config
from mfslam.live.engine import LiveSlam
from mfslam.live.pressure import POSE_LATE_S
from mfslam.live.words import Finished
from mfslam.output import check_writable, json_text, run_folder, write_atomically
from mfslam.output.growing_map import clear_growing_maps
from mfslam.types import Findings, MfslamError, Scan
from mfslam.viewer.place import Place


def run(args: argparse.Namespace) -> int:
    sources = sources_of(args)
    if sources.lidar is None:
        raise MfslamError("expected --lidar: a map needs a laser (`mfslam record` records wheels alone)")
    config = config_of(args, sources.map_settings())
    place = None if args.view is None else place_of(args)
    with run_folder(args.output, args.overwrite):
        if args.json is not None:
            check_writable(args.json)
        drive = Drive(sources, config, args.output, free_name(args.output), args.duration, place, args.quiet)
        finished = drive.run()
    if args.json is not None:
        write_atomically(args.json, json_text(finished.summary).encode())
    if not args.quiet:
        say(finished.summary, finished.notes, args.output)
        print(f"recording  {drive.recording}   (ROS 2: Foxglove, ros2 bag)")
        again = args.output.with_name(f"{args.output.resolve().name}-offline")
        print(f"map again  {map_command(args, sources, drive.recording, again)}")
    if drive.error is not None:
        raise MfslamError(drive.error)
    return 0


def free_name(folder: Path) -> Path:
    """Where to record: a recording never replaces one."""
    path, number = folder / "recording.mcap", 1
    while path.exists():
        number += 1
        path = folder / f"recording-{number}.mcap"
    return path


class Lateness:
    """By how much scans are later than the promptest ones of late: on the clock that nobody sets."""

    RELAX = 1e-3  # per scan: clocks of sensors drift

    def __init__(self) -> None:
        self._least_s = float("inf")

    def of(self, scan: Scan) -> float:
        behind_s = time.monotonic() - scan.stamp_ns * 1e-9
        self._least_s = min(behind_s, self._least_s + self.RELAX)
        return behind_s - self._least_s


@dataclass
class Drive:
    """One run of the command. ``error``: what ended or spoilt it, though there is a map."""

    sources: Sources
    config: Config
    folder: Path
    recording: Path
    duration_s: float | None
    place: Place | None
    quiet: bool
    error: str | None = None
    findings: Findings = field(default_factory=Findings)

    def run(self) -> Finished:
        """Map until Ctrl-C, SIGTERM, or the end of the duration; then solve and write the folder."""
        status = StatusLine(self.quiet)
        with ExitStack() as stack:
            viewer = open_viewer(self.place, self.folder, status, stack)
            status.tell("starting engine and sensors ...")
            slam = stack.enter_context(LiveSlam(self.config, self.folder))
            ends = stack.enter_context(Ends(lambda: self._leave_at_once(slam)))
            watching = Watching(slam, status, self.folder, viewer)
            try:
                self._follow(slam, watching, ends)
            finally:
                status.close()
            status.tell("the final solve ... (Ctrl-C: leave at once, with what is on disk)")
            finished = slam.finish(
                self.folder,
                self.recording,
                findings=self.findings,
                tell=lambda stage: status.tell(f"{stage} ..."),
            )
            clear_growing_maps(self.folder)
            return finished

    def _follow(self, slam: LiveSlam, watching: Watching, ends: Ends) -> None:
        """Every message to the engine, until the end. Raises MfslamError for sensors that are not there."""
        scans, begun_s, late = 0, time.monotonic(), Lateness()
        feed = AcquisitionFeed(self.sources, self.config, self.recording)
        try:
            with feed:
                while not feed.over:
                    message = feed.poll(0.05)
                    if isinstance(message, Scan):
                        begun_s = begun_s if scans else time.monotonic()
                        scans += 1
                        late_s = late.of(message)
                        if late_s > POSE_LATE_S:
                            slam.pressure.left_out(late_s)
                        slam.feed(message, place=late_s <= POSE_LATE_S)
                    elif message is not None:
                        slam.feed(message)
                    watching.look(feed.health.sensors, lambda: self._notes(feed))
                    time_is_up = self.duration_s is not None and time.monotonic() - begun_s >= self.duration_s
                    if ends.asked or (scans and time_is_up):
                        feed.stop()
        except MfslamError as trouble:  # a sensor was never there, the acquisition died, or the disk is full
            self.error = str(trouble)
            watching.status.tell(f"note: {trouble}")
        finally:
            self.findings.merge(feed.findings)
        if not scans:
            self.recording.unlink(missing_ok=True)
            raise MfslamError(self.error or "no scan came: nothing was mapped")
        if feed.health.recording_error is not None:
            self.error = self.error or feed.health.recording_error

    def _notes(self, feed: AcquisitionFeed) -> list[str]:
        return [] if feed.health.recording_error is None else [feed.health.recording_error]

    def _leave_at_once(self, slam: LiveSlam) -> None:
        """The second Ctrl-C: the acquisition ends its recording by itself, what draws maps is killed."""
        with suppress(OSError):
            os.killpg(slam.back_end_pid, signal.SIGKILL)
        clear_growing_maps(self.folder)
        print(
            f"\nmfslam: left at once: {self.folder} has the map as it was last drawn, if it was, and {self.recording}",
            file=sys.stderr,
            flush=True,
        )
        os._exit(130)
