"""`mfslam live`: from live sensors to a map that grows while the robot drives, and to a recording."""

from __future__ import annotations

import argparse
import os
import shlex
import signal
import sys
import time
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path

from drivers.acquisition.feed import AcquisitionFeed
from drivers.acquisition.sources import Sources
from mfslam.commands.replay import leave_online, say
from mfslam.commands.sensors import config_of, map_command, sources_of
from mfslam.commands.status_line import Ends, StatusLine
from mfslam.commands.view import place_of
from mfslam.commands.watching import Watching, open_viewer
from mfslam.config import Config
from mfslam.live.engine import LiveSlam
from mfslam.live.intake import Intake, from_sensors
from mfslam.live.latency import switch_quickly
from mfslam.live.state import LiveState
from mfslam.live.words import Finished
from mfslam.output import check_writable, json_text, run_folder, write_atomically
from mfslam.output.growing_map import clear_growing_maps
from mfslam.types import Findings, FloatArray, MfslamError
from mfslam.viewer.place import Place


def run(args: argparse.Namespace) -> int:
    sources = sources_of(args)
    if sources.lidar is None:
        raise MfslamError("expected --lidar: a map needs a laser (`mfslam record` records wheels alone)")
    if not args.map_every > 0.0:
        raise MfslamError(f"--map-every {args.map_every:g}: expected more than 0 s")
    config = config_of(args, sources.map_settings())
    place = None if args.view is None else place_of(args)
    with run_folder(args.output, args.overwrite):
        if args.json is not None:
            check_writable(args.json)
        drive = Drive(sources, config, args, free_name(args.output), place)
        finished, state = drive.run()
    if args.json is not None:
        write_atomically(args.json, json_text(finished.summary).encode())
    if not args.quiet:
        say(finished, state, args.output)
        print(f"recording  {drive.recording}   (ROS 2: Foxglove, ros2 bag)")
        again = args.output.with_name(f"{args.output.resolve().name}-offline")
        print(f"look again mfslam view {shlex.quote(str(args.output))}")
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


@dataclass
class Drive:
    """One run of the command. ``error``: what ended or spoilt it, though there is a map."""

    sources: Sources
    config: Config
    args: argparse.Namespace
    recording: Path
    place: Place | None
    error: str | None = None
    findings: Findings = field(default_factory=Findings)
    told: list[tuple[int, FloatArray]] = field(
        default_factory=list
    )  # stamp and pose of each scan, as told at once

    @property
    def folder(self) -> Path:
        return Path(self.args.output)

    def run(self) -> tuple[Finished, LiveState]:
        """Map until Ctrl-C, SIGTERM, or the end of the duration; then solve and write the folder."""
        status = StatusLine(self.args.quiet)
        switch_quickly()
        with ExitStack() as stack:
            viewer = open_viewer(self.place, self.folder, status.tell, stack)
            status.tell("starting engine and sensors ...")
            slam = stack.enter_context(LiveSlam(self.config, self.folder, self.args.map_every, status.tell))
            ends = stack.enter_context(Ends(lambda: self._leave_at_once(slam)))
            watching = Watching(slam, status, self.folder, viewer)
            try:
                self._follow(slam, watching, ends)
            finally:
                status.close()
            watching.solving()
            status.tell("the final solve ... (Ctrl-C: leave at once, with what is on disk)")
            finished = slam.finish(
                self.folder,
                self.recording,
                findings=self.findings,
                tell=lambda stage: status.tell(f"{stage} ..."),
            )
            clear_growing_maps(self.folder)
            state = slam.state()
            watching.show_last(state)
            leave_online(self.folder, finished, self.told, state)
            return finished, state

    def _follow(self, slam: LiveSlam, watching: Watching, ends: Ends) -> None:
        """Every message to the engine, until the end. Raises MfslamError for sensors that are not there."""
        intake, begun_s = Intake(slam), time.monotonic()
        feed = AcquisitionFeed(self.sources, self.config, self.recording)
        duration_s = float("inf") if self.args.duration is None else self.args.duration
        try:
            with feed:
                while not feed.over or len(intake):
                    if not feed.over:
                        from_sensors(feed, intake)
                    pose = intake.take()
                    if pose is not None:
                        begun_s = begun_s if self.told else time.monotonic()
                        self.told.append((slam.placed_ns, pose))
                    watching.look(feed.health.sensors, lambda: self._notes(feed))
                    if ends.asked or (self.told and time.monotonic() - begun_s >= duration_s):
                        feed.stop()
        except MfslamError as trouble:  # a sensor was never there, the acquisition died, or the disk is full
            self.error = str(trouble)
            if self.told:  # else it is all that there is to say
                watching.status.tell(f"note: {trouble}")
        finally:
            self.findings.merge(feed.findings)
        if not self.told:
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
