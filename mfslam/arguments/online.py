"""Arguments of what works with live sensors, and of the page that shows them."""

from __future__ import annotations

from pathlib import Path

from mfslam.arguments.shared import (
    Commands,
    add_log,
    add_map_every,
    add_output,
    add_page,
    add_page_bind,
    add_quiet,
    add_reporting,
    add_sensors,
    add_settings,
    add_topics,
)


def add_record(commands: Commands) -> None:
    command = commands.add_parser("record", help="record live sensors, for `mfslam map` and ROS 2 tools")
    add_sensors(command)
    command.add_argument("-o", "--output", metavar="OUT.mcap", type=Path, required=True, help="a new file")
    add_settings(command)
    add_quiet(command)
    command.set_defaults(module="record", lasting=True)


def add_live(commands: Commands) -> None:
    command = commands.add_parser(
        "live", help="map live sensors while the robot drives, and record them; in a browser with --view"
    )
    add_sensors(command)
    add_output(command, holds="map and recording", kept=", but no recording")
    add_map_every(command)
    add_page(command)
    add_settings(command)
    add_reporting(command)
    command.set_defaults(module="live", lasting=True)


def add_replay(commands: Commands) -> None:
    command = commands.add_parser("replay", help="drive the live engine from a log")
    add_log(command)
    add_output(command)
    command.add_argument(
        "--speed", metavar="X", default="1", help="times the pace of the log, or max: as fast as it maps (1)"
    )
    add_map_every(command)
    add_page(command)
    add_topics(command)
    add_settings(command)
    add_quiet(command)
    command.set_defaults(module="replay", lasting=True)


def add_view(commands: Commands) -> None:
    command = commands.add_parser("view", help="replay a finished run in a browser")
    command.add_argument("run_folder", metavar="OUT", type=Path, help="folder of `mfslam map`")
    command.add_argument("--port", dest="view", metavar="PORT", type=int, help="of the page (8765)")
    add_page_bind(command)
    add_quiet(command, "say nothing but the address")
    command.set_defaults(module="view", lasting=True)
