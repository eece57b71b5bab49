"""Arguments that several commands share."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TypeAlias

# what argparse gives from `add_subparsers`
Commands: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"


def add_settings(command: argparse.ArgumentParser) -> None:
    group = command.add_argument_group("settings (see `mfslam config`; later ones win)")
    group.add_argument(
        "--preset", metavar="NAME", action="append", default=[], help="sensor or robot preset, or a YAML file"
    )
    add_changes(group, "one setting")


def add_changes(group: argparse._ArgumentGroup, one: str) -> None:
    """Of settings, from a file and one by one; ``one``: what one of them is."""
    group.add_argument(
        "--config", metavar="FILE", type=Path, help="YAML file with what differs from the defaults"
    )
    group.add_argument(
        "--set", metavar="STAGE.KEY=VALUE", action="append", default=[], dest="settings", help=one
    )


def add_log(command: argparse.ArgumentParser) -> None:
    command.add_argument("log", metavar="LOG", type=Path, help="CARMEN, urg-text, ROS 1 or ROS 2 log")


def add_topics(command: argparse.ArgumentParser) -> None:
    group = command.add_argument_group("sources (found by type when not named)")
    group.add_argument(
        "--scan-topic", metavar="NAME", help="topic of the laser, or RLASER and such in CARMEN logs"
    )
    group.add_argument("--odometry-topic", metavar="NAME")
    group.add_argument("--imu-topic", metavar="NAME")
    group.add_argument("--wheels-topic", metavar="NAME", help="topic of JointState wheel angles")


def add_map_every(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--map-every", metavar="S", type=float, default=15.0,
        help="the map in OUT is refined and drawn anew at most every so many seconds (15)",
    )  # fmt: skip


def add_sensors(command: argparse.ArgumentParser) -> None:
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


def add_page(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--view",
        metavar="PORT",
        nargs="?",
        type=int,
        const=8765,
        help="show the map in a browser (port 8765)",
    )
    add_page_bind(command)


def add_page_bind(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--view-bind",
        metavar="ADDRESS",
        default="127.0.0.1",
        help="address of this machine to serve the page at (127.0.0.1: nobody else); 0.0.0.0 lets in "
        "whoever has the page's address, which then holds a token",
    )


def add_reporting(command: argparse.ArgumentParser) -> None:
    command.add_argument("--json", metavar="FILE", type=Path, help="write the summary there too")
    add_quiet(command)


def add_quiet(command: argparse.ArgumentParser, leaves: str = "no progress, only errors") -> None:
    command.add_argument("-q", "--quiet", action="store_true", help=leaves)


def add_output(command: argparse.ArgumentParser, holds: str = "results", kept: str = "") -> None:
    command.add_argument(
        "-o", "--output", metavar="OUT", type=Path, required=True, help=f"folder for the {holds}"
    )
    command.add_argument("--overwrite", action="store_true", help=f"replace what OUT holds{kept}")
