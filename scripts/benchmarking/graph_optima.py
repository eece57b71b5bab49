"""Least chi2 of the standard graphs, whether it is certified, and what it cost."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import gtsam

from benchmarking.runs import say
from mfslam.graph.batch import solve
from mfslam.graph.certificate import certify
from mfslam.graph.chordal import chordal_start
from mfslam.output import read_graph
from mfslam.pose_graphs.data import Problem, problem_of

GTSAM_DATA = Path(gtsam.__file__).parent / "Data"
# best known chi2, where there is one
GRAPHS: dict[str, tuple[str, float | None]] = {
    "intel": ("intel.g2o", 546.463),
    "manhattanOlson3500": ("manhattan/manhattanOlson3500.g2o", 146.079),
    "ringCity": ("ringCity/ringCity.g2o", None),
    "M3500": ("M3500.g2o", 137.915),
    "M3500b (TORO)": ("M3500b_toro_order.g2o", None),
    "city10000": ("city10000.g2o", 511.987),
    "w100": (str(GTSAM_DATA / "w100.graph"), 1.138),
    "w10000": (str(GTSAM_DATA / "w10000.graph"), 289.735),
}


def read_problem(folder: Path, file: str) -> Problem:
    return problem_of(read_graph(folder / file))[0]


def optima_table(folder: Path) -> Iterator[list[str]]:
    yield ["graph", "poses", "edges", "chi2", "best known", "of the file's poses", "of the chordal start",
           "lower bound", "certified", "solve CPU s", "certificate CPU s"]  # fmt: skip
    for name, (file, known) in GRAPHS.items():
        say(name)
        problem = read_problem(folder, file)
        began = time.process_time()
        chordal = chordal_start(problem)
        start_s = time.process_time() - began
        if chordal is None:
            continue
        at_file, at_chordal = (float(problem.chi2(x).sum()) for x in (problem.world_T_pose, chordal))
        solution = solve(problem, chordal if at_chordal < at_file else problem.world_T_pose)
        began = time.process_time()
        certificate = certify(problem, solution.world_T_pose)
        yield [
            name, f"{problem.size:,}", f"{len(problem.i):,}", f"{certificate.chi2:.4f}", f"{known}" if known else "-",
            f"{at_file:.4g}", f"{at_chordal:.4g}",
            "-" if certificate.lower_bound is None else f"{certificate.lower_bound:.4f}",
            "yes" if certificate.certified else "no", f"{start_s + solution.cpu_s:.2f}",
            f"{time.process_time() - began:.2f}",
        ]  # fmt: skip
