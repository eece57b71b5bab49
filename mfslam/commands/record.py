"""`mfslam record`: from live sensors to a recording that any power cut leaves usable."""

from __future__ import annotations

import argparse
import sys
import time
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

from drivers.acquisition.pump import Pump
from drivers.acquisition.sources import Sources
from drivers.base import Sensor
from drivers.host_clock import HostClock
from drivers.writers.recorder import Recorder
from mfslam.commands.sensors import config_of, map_command, sources_of
from mfslam.commands.status_line import Ends, StatusLine, describe
from mfslam.config import Config
from mfslam.types import Findings, MfslamError


def run(args: argparse.Namespace) -> int:
    sources = sources_of(args)
    config = config_of(args)
    if args.output.suffix != ".mcap":
        raise MfslamError(f"-o {args.output}: expected a name that ends in .mcap")
    taken = record(sources, config, args.output, args.duration, args.quiet)
    for line in taken.findings.lines():
        print(f"note: {line}", file=sys.stderr)
    if taken.error is not None:
        raise MfslamError(taken.error)
    if not args.quiet:
        print(
            f"{taken.messages} messages in {taken.seconds:.0f} s, {args.output.stat().st_size / 1e6:.1f} MB"
        )
        print(f"recording  {args.output}   (ROS 2: Foxglove, ros2 bag)")
        print(f"map it     {map_command(args, sources, args.output, args.output.with_suffix(''))}")
    return 0


@dataclass
class Taken:
    """What a recording came to."""

    messages: int = 0
    seconds: float = 0.0
    findings: Findings = field(default_factory=Findings)
    error: str | None = None


def record(sources: Sources, config: Config, output: Path, duration_s: float | None, quiet: bool) -> Taken:
    """Record until Ctrl-C, SIGTERM, or ``duration_s`` after the first message. Raises MfslamError."""
    notes = {"lidar": sources.lidar or "none", "wheels": sources.wheels or "none"}
    taken, status = Taken(), StatusLine(quiet)
    with ExitStack() as stack, Ends() as ends:
        status.tell("starting the sensors ...")
        sensors = sources.open(config, HostClock(), stack)
        pump = Pump(sensors, Recorder(output, config, notes))
        started_s = time.monotonic()
        try:
            with pump:
                while not ends.asked and pump.recording_error is None:
                    if pump.poll(0.1) is not None:
                        started_s = time.monotonic() if not taken.messages else started_s
                        taken.messages += 1
                    taken.seconds = time.monotonic() - started_s
                    if duration_s is not None and taken.messages and taken.seconds >= duration_s:
                        break
                    status.show(lambda: _figures(taken, sensors, pump))
        except MfslamError:  # a sensor was never there: what the others said meanwhile is no recording
            output.unlink(missing_ok=True)
            raise
        finally:
            status.close()
    taken.findings, taken.error = pump.findings, pump.recording_error
    return taken


def _figures(taken: Taken, sensors: list[Sensor], pump: Pump) -> str:
    size_bytes = 0 if pump.recorder is None else pump.recorder.size_bytes
    told = "; ".join(describe(sensor.health.as_json()) for sensor in sensors)
    return f"{taken.seconds:6.0f} s, {size_bytes / 1e6:.1f} MB; {told}"
