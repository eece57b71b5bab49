"""Arguments of what makes logs."""

from __future__ import annotations

from pathlib import Path

from mfslam.arguments.shared import Commands, add_changes, add_quiet


def add_simulate(commands: Commands) -> None:
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
    add_changes(group, "one setting of robot, laser or faults")
    group = command.add_argument_group("instead of a log")
    group.add_argument("--list", action="store_true", help="print the names of worlds, lasers and robots")
    group.add_argument(
        "--describe", action="store_true", help="print every setting with its unit and meaning, as YAML"
    )
    group.add_argument(
        "--print-world", action="store_true", help="print the text of WORLD, to begin one's own with"
    )
    add_quiet(command)
    command.set_defaults(module="simulate")
