"""`mfslam simulate`: a log as from a robot, and the exact truth beside it."""

from __future__ import annotations

import argparse
import shlex
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.simulator import HIT_KINDS, Simulation, World, beam_truth, laser_model_names, simulate
from drivers.simulator.catalog import OFFICE, load_world, world_names, world_text
from drivers.simulator.robot import ROBOTS
from drivers.simulator.sensors import LaserModel, stamped_at_first
from drivers.simulator.settings import Settings, describe, load_settings
from drivers.simulator.untold import map_arguments
from drivers.simulator.world import DEFAULT_SPEED_M_S
from drivers.writers.log import Format, format_of, log_stem, write_log
from drivers.writers.truth import write_relations, write_tum
from mfslam.commands.interrupts import Interrupts
from mfslam.commands.progress import Progress
from mfslam.output import check_writable
from mfslam.output.staging import cannot_write
from mfslam.types import Findings, MfslamError

# what a format is usually recorded with, where the user does not say otherwise
_USUAL: dict[str, tuple[str, ...]] = {
    "urg-text": ("laser.name=urg-04lx", "robot.odometry=ticks", "robot.encoder_rate_hz=null"),
}


def run(args: argparse.Namespace) -> int:
    if args.list:
        print(f"worlds: {', '.join(world_names())}, {OFFICE}")
        print(f"lasers: {', '.join(laser_model_names())}")
        print(f"robots: {', '.join(ROBOTS)}")
        return 0
    kind = None if args.output is None else format_of(args.output, args.format)
    settings = _settings(args, kind)
    speed_m_s = DEFAULT_SPEED_M_S if args.speed is None else settings.robot.max_speed_m_s
    if args.describe:
        print(describe(settings))
        return 0
    if args.world is None:
        raise MfslamError(
            f"simulate: expected a WORLD: a file, {OFFICE}, or one of {', '.join(world_names())}"
        )
    if args.print_world:
        print(world_text(args.world, speed_m_s)[0], end="")
        return 0
    if args.output is None or kind is None:
        raise MfslamError("simulate: expected -o LOG, the log to write, for example -o log.mcap")
    if args.seed < 0:
        raise MfslamError(f"--seed {args.seed}: expected a whole number of at least 0")
    world = load_world(args.world, speed_m_s)
    targets = _Targets.of(args.output, args.beam_truth)
    progress = Progress(args.quiet)
    with _prepared(targets, args.overwrite):
        progress.tell(f"simulating {world.name} ...")
        laser = settings.laser.model()
        if kind.startswith("ros"):
            laser = stamped_at_first(laser)
        simulation = simulate(world, settings.robot, laser, seed=args.seed, faults=settings.faults)
        progress.tell("writing ...")
        findings = _write(simulation, world, laser, settings, kind, targets)
    if not args.quiet:
        _say(simulation, settings, kind, targets, findings)
    return 0


def _settings(args: argparse.Namespace, kind: Format | None) -> Settings:
    """The shortcuts of the command line are settings, too."""
    said: list[str] = []
    if args.laser is not None:
        said.append(f"laser.name={args.laser}")
    if args.mount is not None:
        values = args.mount.split(",")
        if len(values) != 3:
            raise MfslamError(f"--mount {args.mount}: expected X,Y,YAW in m, m and deg, for example 0.1,0,0")
        keys = ("mount_x_m", "mount_y_m", "mount_yaw_deg")
        said += [f"laser.{key}={value}" for key, value in zip(keys, values, strict=True)]
    if args.speed is not None:
        said.append(f"robot.max_speed_m_s={args.speed}")
    files = [] if args.config is None else [args.config]
    return load_settings(args.robot, _USUAL.get(kind or "", ()), files, [*said, *args.settings])


# --- the files ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Targets:
    """What is left behind: the log, its truth as trajectory and relations, and on request at every beam."""

    log: Path
    trajectory: Path
    relations: Path
    beams: Path | None

    @staticmethod
    def of(log: Path, beams: Path | None) -> _Targets:
        stem = log_stem(log)
        return _Targets(log, log.with_name(f"{stem}.truth.tum"), log.with_name(f"{stem}.relations"), beams)

    def all(self) -> list[Path]:
        return [path for path in (self.log, self.trajectory, self.relations, self.beams) if path is not None]


@contextmanager
def _prepared(targets: _Targets, overwrite: bool) -> Iterator[None]:
    """Refuse before the work what could not be written after it; leave no new folder when it fails."""
    if targets.beams is not None and targets.beams.suffix != ".npz":
        raise MfslamError(f"--beam-truth {targets.beams}: expected a name that ends in .npz")
    if len(set(targets.all())) < len(targets.all()):
        raise MfslamError(f"--beam-truth {targets.beams}: is the name of another file of this run")
    for path in targets.all():
        if path.exists() and not overwrite:
            raise MfslamError(f"{path}: exists already; give --overwrite to replace it, or another -o")
        if path.is_dir() and not (path == targets.log and (path / "metadata.yaml").is_file()):
            raise MfslamError(f"{path}: is a folder and no bag: not replaced; choose another name")
    folders = {path.parent for path in targets.all()}
    new = [f for folder in folders for f in (folder, *folder.parents) if not f.exists()]
    try:
        for folder in folders:
            folder.mkdir(parents=True, exist_ok=True)
        for path in targets.all():
            if not path.is_dir():
                check_writable(path)
        yield
    except BaseException as error:
        for folder in sorted(new, key=lambda f: len(f.parts), reverse=True):
            with suppress(OSError):  # one that holds something stays
                folder.rmdir()
        if isinstance(error, OSError):
            raise cannot_write(targets.log, error) from None
        raise


def _write(
    simulation: Simulation,
    world: World,
    laser: LaserModel,
    settings: Settings,
    kind: Format,
    targets: _Targets,
) -> Findings:
    """All files aside, then all in place."""
    stamps, poses = simulation.truth_stamps_ns, simulation.truth_world_T_body
    with tempfile.TemporaryDirectory(prefix=".simulating-", dir=targets.log.parent) as name:
        aside = Path(name)
        made = {path: aside / path.name for path in targets.all()}
        findings = write_log(simulation.messages, made[targets.log], kind, wheels=settings.robot.wheels)
        write_tum(made[targets.trajectory], stamps, poses)
        write_relations(made[targets.relations], stamps, poses)
        if targets.beams is not None:
            truth = beam_truth(world, simulation.motion, laser, simulation.instants_s)
            np.savez(
                made[targets.beams],
                stamps_ns=stamps,
                world_T_laser=truth.world_T_laser,
                range_m=truth.ranges_m,
                hit=truth.hits,
                hit_kinds=np.array(HIT_KINDS),
            )
        with Interrupts():  # not between two of them
            for path, file in made.items():
                if path.is_dir():
                    shutil.rmtree(path)
                shutil.move(file, path)
    return findings


def _say(
    simulation: Simulation, settings: Settings, kind: Format, targets: _Targets, findings: Findings
) -> None:
    scans = simulation.scans
    beams = sum(len(scan.ranges_m) for scan in scans)
    motion = simulation.motion
    print(f"{motion.distance_m:.0f} m in {motion.duration_s:.0f} s, {len(scans)} scans, {beams} beams")
    for line in findings.lines():
        print(f"note: {line}", file=sys.stderr)
    print(f"log     {targets.log}   ({kind})")
    print(f"truth   {', '.join(str(path) for path in targets.all()[1:])}")
    out = targets.log.with_name(f"{log_stem(targets.log)}-map")
    command = ["mfslam", "map", str(targets.log), "-o", str(out), *map_arguments(targets.log, kind, settings)]
    print(f"map it  {shlex.join(command)}")
