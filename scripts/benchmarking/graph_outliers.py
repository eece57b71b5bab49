"""What false loops do to a graph, kernel by kernel."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarking.false_loops import Kind, with_false_loops
from benchmarking.graph_optima import read_problem
from benchmarking.runs import say
from benchmarking.tables import Table
from mfslam import se2
from mfslam.commands.optimize import KERNEL_SIGMAS
from mfslam.graph.batch import Solution, solve
from mfslam.graph.robust import dead_reckoning, solve_robust
from mfslam.metrics import ate
from mfslam.pose_graphs.chordal import chordal_start
from mfslam.pose_graphs.data import Problem
from mfslam.types import BoolArray, FloatArray, MfslamError

METHODS = ("none", *KERNEL_SIGMAS, "gnc")
KINDS: tuple[Kind, ...] = ("uniform", "grouped")
SHARES = (0.1, 0.2, 0.5)
SEED = 1
_ITERATIONS = 10  # of a kernel: false loops make a graph dense, and what is stuck by then stays stuck
NOISE = 0.1  # of ringCity's sigmas, which the file states and does not have


def outlier_table(folder: Path) -> Table:
    rows = [["graph", "false loops", *METHODS, "gnc CPU s"]]
    for name, (problem, truth) in _graphs(folder).items():
        clean = solve(problem, _start(problem))
        reference = clean.world_T_pose if truth is None else truth
        error = ate(reference, clean.world_T_pose).translation_m.rmse
        rows.append([f"{name}", "none", f"{error:.3f}", *["-"] * (len(METHODS) - 1), "-"])
        for kind in KINDS:
            for share in SHARES:
                say(f"{name}, {share:.0%} {kind}")
                spoiled, false = with_false_loops(problem, clean.world_T_pose, share, kind, SEED)
                cells, cpu_s = [], 0.0
                for method in METHODS:
                    solution = _solve(spoiled, method)
                    cells.append(_cell(reference, solution, false))
                    cpu_s = solution.cpu_s if solution is not None else 0.0
                rows.append([name, f"{share:.0%} {kind} ({int(false.sum()):,})", *cells, f"{cpu_s:.1f}"])
                say(" | ".join(rows[-1]))
    return rows


def _graphs(folder: Path) -> dict[str, tuple[Problem, FloatArray | None]]:
    manhattan = np.loadtxt(folder / "manhattan" / "manhattanOlson3500_nodes_groundTruth.dat")
    ring = np.loadtxt(folder / "ringCity" / "poses.txt")[:, 1:]
    exact = read_problem(folder, "ringCity/ringCity.g2o")
    return {
        "intel (against its own optimum)": (read_problem(folder, "intel.g2o"), None),
        "ringCity": (exact, ring),
        f"ringCity, noise of {NOISE:g} of its sigmas": (_noisy(exact), ring),
        "manhattanOlson3500": (read_problem(folder, "manhattan/manhattanOlson3500.g2o"), manhattan),
    }


def _noisy(problem: Problem) -> Problem:
    rng = np.random.default_rng(SEED)
    sigmas = NOISE / np.sqrt(np.einsum("eaa->ea", problem.information))
    noise = se2.exp(rng.normal(0.0, 1.0, sigmas.shape) * sigmas)
    return Problem(
        problem.world_T_pose,
        problem.i,
        problem.j,
        se2.compose(problem.i_T_j, noise),
        problem.information,
        problem.held,
    )


def _start(problem: Problem) -> FloatArray:
    chordal = chordal_start(problem)
    return problem.world_T_pose if chordal is None else chordal


def _solve(problem: Problem, method: str) -> Solution | None:
    """All but gnc begin where a robot would: at dead reckoning."""
    reckoned = dead_reckoning(problem)
    start = problem.world_T_pose if reckoned is None else reckoned
    try:
        if method == "gnc":
            return solve_robust(problem, start)
        kernel = None if method == "none" else (method, KERNEL_SIGMAS[method])
        return solve(problem, start, kernel=kernel, max_iterations=_ITERATIONS)
    except MfslamError:
        return None


def _cell(reference: FloatArray, solution: Solution | None, false: BoolArray) -> str:
    if solution is None:
        return "failed"
    error = ate(reference, solution.world_T_pose).translation_m.rmse
    return f"{error:.3f} ({int((solution.weights[false] >= 0.5).sum()):,})"
