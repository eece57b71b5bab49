"""The command line: what can be asked, and nothing heavy until it is."""

from __future__ import annotations

import argparse
import gc
import os
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

from mfslam import __version__
from mfslam.arguments import mapping, online, results, simulation


def program() -> int:
    """`mfslam` as a program of its own. One that ends goes at once: to take a million objects apart first would be a sixtieth of
    its time."""
    args = _parsed(None)
    status = _run(args)
    if not args.lasting:
        sys.stderr.flush()
        os._exit(status)
    return status


def main(argv: Sequence[str]) -> int:
    """Run one command; returns the exit status: 0 done, 1 told why not, 130 interrupted. Raises SystemExit (2) where it is misused."""
    return _run(_parsed(argv))


def _parsed(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = build_parser()
    args = parser.parse_args(argv)
    if "module" not in args:
        parser.print_help(sys.stderr)
        parser.exit(2)
    return args


def _run(args: argparse.Namespace) -> int:
    args.start_cpu_s = time.process_time()
    # before numpy is loaded: our matrices are small, and threads of its algebra that wait for work take a twentieth of a run
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from mfslam.types import MfslamError

    try:
        with _no_cycles_sought():
            check_neighbours()
            command = import_module(f"mfslam.commands.{args.module}")
            if args.lasting:
                gc.freeze()
                gc.enable()
            status = int(command.run(args))
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


@contextmanager
def _no_cycles_sought() -> Iterator[None]:
    """A run that ends leaves hardly any cycles of objects behind, and to look for them among millions takes a twelfth of
    its time. What counts references gives memory back as ever."""
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.enable()


def _fail(line: str) -> int:
    print(f"mfslam: {line}", file=sys.stderr)
    return 1


def build_parser() -> argparse.ArgumentParser:
    """Each command names its module in `mfslam.commands`, which is imported when it runs, and says whether it runs until
    it is stopped (``lasting``)."""
    parser = argparse.ArgumentParser(
        prog="mfslam", description="2D laser SLAM in which every beam has its own instant."
    )
    parser.set_defaults(lasting=False)
    parser.add_argument("--version", action="version", version=f"mfslam {__version__}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND")
    for add in (
        mapping.add_map, mapping.add_demo, simulation.add_simulate, online.add_record, online.add_replay,
        online.add_live, online.add_view, mapping.add_info, mapping.add_calibrate, results.add_evaluate,
        results.add_compare, results.add_optimize, mapping.add_config,
    ):  # fmt: skip
        add(commands)
    return parser


def check_neighbours() -> None:
    """The top-level packages `drivers` and `factors` must be ours: another installed package of that name
    would take their place in silence. Raises MfslamError."""
    from mfslam.types import MfslamError

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


if __name__ == "__main__":
    sys.exit(program())
