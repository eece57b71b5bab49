"""Arguments of what maps a log, or tells of one."""

from __future__ import annotations

from pathlib import Path

from mfslam.arguments.shared import Commands, add_log, add_output, add_reporting, add_settings, add_topics


def add_map(commands: Commands) -> None:
    command = commands.add_parser("map", help="map a log: trajectory, factor graph, occupancy grid, report")
    add_log(command)
    add_output(command)
    command.add_argument(
        "--calibrate",
        choices=("auto", "off"),
        default="auto",
        help="map once more with the mount and delay that the log tells, where these are surely other than assumed "
        "(auto; for logs of wheels that have a stream of their own)",
    )
    add_topics(command)
    add_settings(command)
    add_reporting(command)
    command.set_defaults(module="map_log")


def add_demo(commands: Commands) -> None:
    command = commands.add_parser("demo", help="simulate a fast robot in a few rooms and map its log")
    command.add_argument(
        "-o", "--output", metavar="OUT", type=Path, default=Path("mfslam-demo"), help="folder (./mfslam-demo)"
    )
    command.add_argument("--overwrite", action="store_true", help="replace what OUT holds, if it is no demo")
    command.add_argument("--seed", type=int, default=1, help="of the simulated noise (1)")
    add_settings(command)
    add_reporting(command)
    command.set_defaults(module="demo")


def add_info(commands: Commands) -> None:
    command = commands.add_parser("info", help="tell what a log holds and what is odd in it")
    command.add_argument("log", metavar="LOG", type=Path)
    add_topics(command)
    add_settings(command)
    command.add_argument("--json", metavar="FILE", type=Path, help="write it as JSON too")
    command.set_defaults(module="info")


def add_calibrate(commands: Commands) -> None:
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
    add_topics(command)
    add_settings(command)
    add_reporting(command)
    command.set_defaults(module="calibrate")


def add_config(commands: Commands) -> None:
    command = commands.add_parser("config", help="print every setting with its unit and meaning, as YAML")
    add_settings(command)
    command.set_defaults(module="config")
