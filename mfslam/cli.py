"""The command line: what can be asked, and nothing heavy until it is."""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

from mfslam import __version__
from mfslam.types import MfslamError


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit status: 0 done, 1 told why not, 2 misused, 130 interrupted."""
    parser = build_parser()
    args = parser.parse_args(argv)
    if "run" not in args:
        parser.print_help(sys.stderr)
        return 2
    args.start_cpu_s = time.process_time()
    try:
        check_neighbours()
        status = int(args.run(args))
        sys.stdout.flush()
        return status
    except MfslamError as error:
        return _fail(str(error))
    except KeyboardInterrupt:
        print("mfslam: interrupted: nothing was written", file=sys.stderr)
        return 130
    except BrokenPipeError:  # whoever read our output has gone (| head): nothing to tell, nothing to flush
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
    except MemoryError:
        return _fail("out of memory: a coarser map.resolution_m or a shorter log needs less")
    except OSError as error:  # a disk that fails on the way, for one
        return _fail(f"{error.filename or 'output'}: {(error.strerror or str(error)).lower()}")


def _fail(line: str) -> int:
    print(f"mfslam: {line}", file=sys.stderr)
    return 1


def build_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="mfslam", description="2D laser SLAM in which every beam has its own instant."
    )
    parser.add_argument("--version", action="version", version=f"mfslam {__version__}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND")

    command = commands.add_parser("map", help="map a log: trajectory, factor graph, occupancy grid, report")
    command.add_argument("log", metavar="LOG", type=Path, help="CARMEN, urg-text, ROS 1 or ROS 2 log")
    command.add_argument(
        "-o", "--output", metavar="OUT", type=Path, required=True, help="folder for the results"
    )
    command.add_argument("--overwrite", action="store_true", help="replace what OUT holds")
    command.add_argument(
        "--calibrate",
        choices=("auto", "off"),
        default="auto",
        help="map once more with the mount and delay that the log tells, where these are surely other than assumed "
        "(auto; for logs of wheels that have a stream of their own)",
    )
    _add_topics(command)
    _add_settings(command)
    _add_reporting(command)
    command.set_defaults(run=_run_map)

    command = commands.add_parser("demo", help="simulate a fast robot in a few rooms and map its log")
    command.add_argument(
        "-o", "--output", metavar="OUT", type=Path, default=Path("mfslam-demo"), help="folder (./mfslam-demo)"
    )
    command.add_argument("--overwrite", action="store_true", help="replace what OUT holds, if it is no demo")
    command.add_argument("--seed", type=int, default=1, help="of the simulated noise (1)")
    _add_settings(command)
    _add_reporting(command)
    command.set_defaults(run=_run_demo)

    _add_simulate(commands)

    command = commands.add_parser("record", help="record live sensors, for `mfslam map` and ROS 2 tools")
    _add_sensors(command)
    command.add_argument("-o", "--output", metavar="OUT.mcap", type=Path, required=True, help="a new file")
    _add_settings(command)
    command.add_argument("-q", "--quiet", action="store_true", help="no progress, only errors")
    command.set_defaults(run=_run_record)

    command = commands.add_parser("replay", help="drive the live engine from a log")
    command.add_argument("log", metavar="LOG", type=Path, help="CARMEN, urg-text, ROS 1 or ROS 2 log")
    command.add_argument(
        "-o", "--output", metavar="OUT", type=Path, required=True, help="folder for the results"
    )
    command.add_argument("--overwrite", action="store_true", help="replace what OUT holds")
    command.add_argument(
        "--speed", metavar="X", default="1", help="times the pace of the log, or max: as fast as it maps (1)"
    )
    _add_map_every(command)
    _add_view(command)
    _add_topics(command)
    _add_settings(command)
    command.add_argument("-q", "--quiet", action="store_true", help="no progress, only errors")
    command.set_defaults(run=_run_replay)

    command = commands.add_parser(
        "live", help="map live sensors while the robot drives, and record them; in a browser with --view"
    )
    _add_sensors(command)
    command.add_argument(
        "-o", "--output", metavar="OUT", type=Path, required=True, help="folder for map and recording"
    )
    command.add_argument("--overwrite", action="store_true", help="replace what OUT holds, but no recording")
    _add_map_every(command)
    _add_view(command)
    _add_settings(command)
    _add_reporting(command)
    command.set_defaults(run=_run_live)

    command = commands.add_parser("view", help="replay a finished run in a browser")
    command.add_argument("run_folder", metavar="OUT", type=Path, help="folder of `mfslam map`")
    command.add_argument("--port", dest="view", metavar="PORT", type=int, help="of the page (8765)")
    _add_view_bind(command)
    command.add_argument("-q", "--quiet", action="store_true", help="say nothing but the address")
    command.set_defaults(run=_run_view)

    command = commands.add_parser("info", help="tell what a log holds and what is odd in it")
    command.add_argument("log", metavar="LOG", type=Path)
    _add_topics(command)
    _add_settings(command)
    command.add_argument("--json", metavar="FILE", type=Path, help="write it as JSON too")
    command.set_defaults(run=_run_info)

    command = commands.add_parser(
        "calibrate",
        help="find wheels, laser mount and delay of a robot from its ordinary logs",
        description="Calibrate a robot by one or several of its logs and write the settings for map and live.",
    )
    command.add_argument("log", metavar="LOG", nargs="+", type=Path, help="logs of one robot, as for map")
    command.add_argument(
        "-o", "--output", metavar="FILE.yaml", type=Path, default=Path("calibration.yaml"),
        help="settings for --config (./calibration.yaml)",
    )  # fmt: skip
    command.add_argument("--overwrite", action="store_true", help="replace FILE.yaml")
    _add_topics(command)
    _add_settings(command)
    _add_reporting(command)
    command.set_defaults(run=_run_calibrate)

    _add_evaluate(commands)
    _add_compare(commands)
    _add_optimize(commands)

    command = commands.add_parser("config", help="print every setting with its unit and meaning, as YAML")
    _add_settings(command)
    command.set_defaults(run=_run_config)
    return parser


def _add_simulate(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    command = commands.add_parser(
        "simulate",
        help="simulate a robot's log, with the exact truth beside it",
        description="Drive a robot through a world and write its log; beside LOG its truth as .truth.tum and .relations.",
    )
    command.add_argument(
        "world",
        metavar="WORLD",
        nargs="?",
        help="corridor, demo, h-aisle, hall, office, square-aisle; a file; or a random office:SEED[:ROOMS[:LAPS]]",
    )
    command.add_argument(
        "-o",
        "--output",
        metavar="LOG",
        type=Path,
        help=".clf or .log (CARMEN), .dat (urg-text), .bag, .mcap, .db3, or a folder (ROS 2 bag)",
    )
    command.add_argument(
        "--format", metavar="FORMAT", help="the same by name, where the suffix does not tell"
    )
    command.add_argument(
        "--beam-truth", metavar="FILE.npz", type=Path, help="write the truth at every beam, too"
    )
    command.add_argument("--overwrite", action="store_true", help="replace files that exist")
    command.add_argument(
        "--laser",
        metavar="NAME",
        help="generic (default), fast, rplidar-a1, rplidar-a2, sick-lms200, sick-lms291, urg-04lx or utm-30lx",
    )
    command.add_argument(
        "--mount", metavar="X,Y,YAW", help="of the laser on the robot: m, m, deg (write --mount=-0.1,0,0)"
    )
    command.add_argument(
        "--robot",
        metavar="NAME",
        default="wheels",
        help="what the robot's settings start from: wheels (default) or tracks",
    )
    command.add_argument(
        "--speed",
        metavar="M_S",
        help="highest speed, m/s, and the limit where the world states none (1); as robot.max_speed_m_s",
    )
    command.add_argument("--seed", type=int, default=0, help="of all noise (0)")
    group = command.add_argument_group("settings (see --describe; later ones win)")
    group.add_argument(
        "--config", metavar="FILE", type=Path, help="YAML file with what differs from the defaults"
    )
    group.add_argument(
        "--set",
        metavar="STAGE.KEY=VALUE",
        action="append",
        default=[],
        dest="settings",
        help="one setting of robot, laser or faults",
    )
    group = command.add_argument_group("instead of a log")
    group.add_argument("--list", action="store_true", help="print the names of worlds, lasers and robots")
    group.add_argument(
        "--describe", action="store_true", help="print every setting with its unit and meaning, as YAML"
    )
    group.add_argument(
        "--print-world", action="store_true", help="print the text of WORLD, to begin one's own with"
    )
    command.add_argument("-q", "--quiet", action="store_true", help="no progress, only errors")
    command.set_defaults(run=_run_simulate)


def _add_evaluate(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    command = commands.add_parser(
        "evaluate",
        help="say how good trajectories and graphs of any program are",
        description="Hold results against a truth; several results side by side, with a test of their differences.",
    )
    command.add_argument(
        "results",
        metavar="RESULT",
        nargs="+",
        type=Path,
        help="folder of `mfslam map`, TUM trajectory, corrected CARMEN log (.clf, .log), or graph (.g2o)",
    )
    truth = command.add_mutually_exclusive_group(required=True)
    truth.add_argument("--relations", metavar="FILE", type=Path, help="true motions between pairs of stamps")
    truth.add_argument(
        "--truth", metavar="FILE", type=Path, help="true trajectory: TUM, CARMEN or run folder"
    )
    truth.add_argument(
        "--graph-truth",
        metavar="FILE",
        type=Path,
        help="true poses of vertices, or true edges: g2o or a table",
    )
    command.add_argument("-o", "--output", metavar="PAGE.html", type=Path, help="write a page of plots")
    command.add_argument("--json", metavar="FILE", type=Path, help="write all figures as JSON")
    command.add_argument("--list", metavar="FILE.csv", type=Path, help="write every single error")
    command.add_argument(
        "--tolerance",
        metavar="S",
        type=float,
        default=1e-5,
        help="between stamps of relations and poses (1e-5)",
    )
    command.add_argument(
        "--max-difference",
        metavar="S",
        type=float,
        default=0.01,
        help="between stamps of truth and poses (0.01)",
    )
    command.add_argument(
        "--rpe-step", metavar="N", type=int, default=1, help="poses between those of RPE (1)"
    )
    command.add_argument("-q", "--quiet", action="store_true", help="print nothing but errors")
    command.set_defaults(run=_run_evaluate)


def _add_compare(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    command = commands.add_parser("compare", help="say what changed between two runs")
    command.add_argument("a", metavar="RUN_A", type=Path, help="folder of `mfslam map`")
    command.add_argument("b", metavar="RUN_B", type=Path, help="another one, of the same log")
    command.add_argument("-o", "--output", metavar="PAGE.html", type=Path, help="write a page")
    command.add_argument("--picture", metavar="FILE.png", type=Path, help="write the difference of the maps")
    command.add_argument("--json", metavar="FILE", type=Path, help="write all figures as JSON")
    command.add_argument("-q", "--quiet", action="store_true", help="print nothing but errors")
    command.set_defaults(run=_run_compare)


def _add_optimize(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    command = commands.add_parser(
        "optimize",
        help="optimise a pose graph of any program, and say how good it is",
        description="Optimise a planar pose graph (g2o or TORO) and say whether the result is the global optimum.",
    )
    command.add_argument("graph", metavar="GRAPH", type=Path, help="g2o or TORO file")
    command.add_argument("-o", "--output", metavar="OUT.g2o", type=Path, help="write the solved graph")
    command.add_argument("--json", metavar="FILE", type=Path, help="write what was found as JSON")
    command.add_argument(
        "--start",
        choices=("auto", "file", "chordal"),
        default="auto",
        help="poses to begin from: auto takes those of lower chi2 (default)",
    )
    how = command.add_mutually_exclusive_group()
    how.add_argument(
        "--robust",
        choices=("none", "gnc", "huber", "cauchy", "geman-mcclure", "dcs", "tls"),
        default="none",
        help="against false loops; edges between neighbours in the file are trusted (none)",
    )
    how.add_argument("--incremental", action="store_true", help="one pose at a time by iSAM2, with times")
    command.add_argument("--kernel-sigmas", metavar="S", type=float, help="scale of the robust kernel")
    command.add_argument(
        "--information-order",
        choices=("g2o", "toro"),
        help="of the six numbers of an information matrix, where tags mislead",
    )
    command.add_argument("--no-certificate", action="store_true", help="do not look for a lower bound")
    command.add_argument("-q", "--quiet", action="store_true", help="print nothing but errors")
    command.set_defaults(run=_run_optimize)


def _add_settings(command: argparse.ArgumentParser) -> None:
    group = command.add_argument_group("settings (see `mfslam config`; later ones win)")
    group.add_argument(
        "--preset", metavar="NAME", action="append", default=[], help="sensor or robot preset, or a YAML file"
    )
    group.add_argument(
        "--config", metavar="FILE", type=Path, help="YAML file with what differs from the defaults"
    )
    group.add_argument(
        "--set", metavar="STAGE.KEY=VALUE", action="append", default=[], dest="settings", help="one setting"
    )


def _add_topics(command: argparse.ArgumentParser) -> None:
    group = command.add_argument_group("sources (found by type when not named)")
    group.add_argument(
        "--scan-topic", metavar="NAME", help="topic of the laser, or RLASER and such in CARMEN logs"
    )
    group.add_argument("--odometry-topic", metavar="NAME")
    group.add_argument("--imu-topic", metavar="NAME")
    group.add_argument("--wheels-topic", metavar="NAME", help="topic of JointState wheel angles")


def _add_map_every(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--map-every", metavar="S", type=float, default=15.0,
        help="the map in OUT is refined and drawn anew at most every so many seconds (15)",
    )  # fmt: skip


def _add_sensors(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--lidar",
        metavar="SENSOR",
        help="urg:/dev/ttyACM0, urg:HOST:PORT, rplidar:MODEL:/dev/ttyUSB0, lds:MODEL:/dev/ttyUSB0 or sim:WORLD",
    )
    command.add_argument(
        "--wheels",
        metavar="BOARD",
        help="board:/dev/ttyUSB0, arduino:/dev/ttyUSB0, or sim beside a simulated lidar",
    )
    command.add_argument("--duration", metavar="S", type=float, help="stop after so long, s (on Ctrl-C)")


def _add_view(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--view",
        metavar="PORT",
        nargs="?",
        type=int,
        const=8765,
        help="show the map in a browser (port 8765)",
    )
    _add_view_bind(command)


def _add_view_bind(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--view-bind",
        metavar="ADDRESS",
        default="127.0.0.1",
        help="address of this machine to serve the page at (127.0.0.1: nobody else); 0.0.0.0 lets in "
        "whoever has the page's address, which then holds a token",
    )


def _add_reporting(command: argparse.ArgumentParser) -> None:
    command.add_argument("--json", metavar="FILE", type=Path, help="write the summary there too")
    command.add_argument("-q", "--quiet", action="store_true", help="no progress, only errors")


def check_neighbours() -> None:
    """The top-level packages `drivers` and `factors` must be ours: another installed package of that name
    would take their place in silence. Raises MfslamError."""
    home = Path(__file__).resolve().parent.parent
    for name in ("drivers", "factors"):
        spec = find_spec(name)
        if spec is None or spec.origin is None:
            raise MfslamError(f"the package {name!r} is missing: install mfslam again")
        found = Path(spec.origin).resolve().parent.parent
        if found != home:
            raise MfslamError(
                f"the package {name!r} comes from {found}, not from beside mfslam in {home}: another installed "
                "package of that name hides ours; use a fresh virtual environment"
            )


def _run_map(args: argparse.Namespace) -> int:
    from mfslam.commands.map_log import run

    return run(args)


def _run_calibrate(args: argparse.Namespace) -> int:
    from mfslam.commands.calibrate import run

    return run(args)


def _run_demo(args: argparse.Namespace) -> int:
    from mfslam.commands.demo import run

    return run(args)


def _run_simulate(args: argparse.Namespace) -> int:
    from mfslam.commands.simulate import run

    return run(args)


def _run_record(args: argparse.Namespace) -> int:
    from mfslam.commands.record import run

    return run(args)


def _run_replay(args: argparse.Namespace) -> int:
    from mfslam.commands.replay import run

    return run(args)


def _run_live(args: argparse.Namespace) -> int:
    from mfslam.commands.live import run

    return run(args)


def _run_view(args: argparse.Namespace) -> int:
    from mfslam.commands.view import run

    return run(args)


def _run_info(args: argparse.Namespace) -> int:
    from mfslam.commands.info import run

    return run(args)


def _run_evaluate(args: argparse.Namespace) -> int:
    from mfslam.commands.evaluate import run

    return run(args)


def _run_compare(args: argparse.Namespace) -> int:
    from mfslam.commands.compare import run

    return run(args)


def _run_optimize(args: argparse.Namespace) -> int:
    from mfslam.commands.optimize import run

    return run(args)


def _run_config(args: argparse.Namespace) -> int:
    from mfslam.settings import describe, load, preset_path

    files = [preset_path(name) for name in args.preset] + ([args.config] if args.config else [])
    print(describe(load(files, args.settings)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
