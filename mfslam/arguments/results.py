"""Arguments of what judges results, and solves graphs of any program."""

from __future__ import annotations

from pathlib import Path

from mfslam.arguments.shared import Commands, add_quiet


def add_evaluate(commands: Commands) -> None:
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
    add_quiet(command, "print nothing but errors")
    command.set_defaults(module="evaluate")


def add_compare(commands: Commands) -> None:
    command = commands.add_parser("compare", help="say what changed between two runs")
    command.add_argument("a", metavar="RUN_A", type=Path, help="folder of `mfslam map`")
    command.add_argument("b", metavar="RUN_B", type=Path, help="another one, of the same log")
    command.add_argument("-o", "--output", metavar="PAGE.html", type=Path, help="write a page")
    command.add_argument("--picture", metavar="FILE.png", type=Path, help="write the difference of the maps")
    command.add_argument("--json", metavar="FILE", type=Path, help="write all figures as JSON")
    add_quiet(command, "print nothing but errors")
    command.set_defaults(module="compare")


def add_optimize(commands: Commands) -> None:
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
    add_quiet(command, "print nothing but errors")
    command.set_defaults(module="optimize")
