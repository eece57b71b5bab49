"""`mfslam record`: from live sensors to a recording that any power cut leaves usable."""

from __future__ import annotations

import argparse
import shlex
import signal
import sys
import time
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType

from drivers.acquisition.pump import Pump
from drivers.acquisition.sources import Sources
from drivers.base import SensorHealth
from drivers.host_clock import HostClock
from drivers.writers.recorder import Recorder
from mfslam.config import Config
from mfslam.settings import load, preset_path
from mfslam.types import Findings, MfslamError

TELL_EVERY_S = 10.0  # where the output is no terminal


def run(args: argparse.Namespace) -> int:
    sources = Sources(args.lidar, args.wheels)
    files = [preset_path(name) for name in args.preset] + ([args.config] if args.config else [])
    config = load(files, args.settings)
    if args.output.suffix != ".mcap":
        raise MfslamError(f"-o {args.output}: expected a name that ends in .mcap")
    if args.duration is not None and args.duration <= 0.0:
        raise MfslamError(f"--duration {args.duration:g}: expected more than 0 s")
    taken = record(sources, config, args.output, args.duration, args.quiet)
    for line in taken.findings.lines():
        print(f"note: {line}", file=sys.stderr)
    if taken.error is not None:
        raise MfslamError(taken.error)
    if not args.quiet:
        out = args.output.with_suffix("")
        print(
            f"{taken.messages} messages in {taken.seconds:.0f} s, {args.output.stat().st_size / 1e6:.1f} MB"
        )
        print(f"recording  {args.output}   (ROS 2: Foxglove, ros2 bag)")
        command = ["mfslam", "map", str(args.output), "-o", str(out)]
        command += [word for name in args.preset for word in ("--preset", name)]
        command += [word for text in sources.map_settings() for word in ("--set", text)]
        print(f"map it     {shlex.join(command)}")
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
    taken, status = Taken(), _StatusLine(quiet)
    with ExitStack() as stack, _Ends() as ends:
        status.tell("starting the sensors ...")
        sensors = sources.open(config, HostClock(), stack)
        pump = Pump(sensors, Recorder(output, config.wheels, notes))
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
                    assert pump.recorder is not None
                    status.show(taken.seconds, [s.health for s in sensors], pump.recorder.size_bytes)
        except MfslamError:  # a sensor was never there: what the others said meanwhile is no recording
            output.unlink(missing_ok=True)
            raise
        finally:
            status.close()
    taken.findings, taken.error = pump.findings, pump.recording_error
    return taken


class _Ends:
    """Ctrl-C and SIGTERM ask for a good end."""

    def __init__(self) -> None:
        self.asked = False

    def __enter__(self) -> _Ends:
        self._before = {n: signal.signal(n, self._ask) for n in (signal.SIGINT, signal.SIGTERM)}
        return self

    def __exit__(self, *_: object) -> None:
        for number, before in self._before.items():
            signal.signal(number, before)

    def _ask(self, number: int, frame: FrameType | None) -> None:
        self.asked = True


class _StatusLine:
    """How it goes, on standard error: one line that is renewed, or one now and then where that is no terminal."""

    def __init__(self, quiet: bool) -> None:
        self._quiet, self._terminal = quiet, sys.stderr.isatty()
        self._next_s = 0.0
        self._shown = 0

    def tell(self, text: str) -> None:
        if not self._quiet:
            print(text, file=sys.stderr, flush=True)

    def show(self, seconds: float, sensors: list[SensorHealth], size_bytes: int) -> None:
        if self._quiet or time.monotonic() < self._next_s:
            return
        self._next_s = time.monotonic() + (0.5 if self._terminal else TELL_EVERY_S)
        text = f"{seconds:6.0f} s, {size_bytes / 1e6:.1f} MB; " + "; ".join(map(describe, sensors))
        if not self._terminal:
            self.tell(text)
            return
        print(f"\r{text:<{self._shown}}", end="", file=sys.stderr, flush=True)
        self._shown = len(text)

    def close(self) -> None:
        if self._shown:
            print(file=sys.stderr)


def describe(health: SensorHealth) -> str:
    """One sensor in a few words."""
    if not health.connected:
        return f"{health.name}: {health.text}"
    errors = sum(health.errors.values())
    told = f"{health.name}: {health.rate_hz:.1f} Hz, {health.delay_s * 1e3:.0f} ms late"
    return told + (f", {errors} errors" if errors else "")
