"""What false loops do to a graph, kernel by kernel."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarking.false_loops import Kind, with_false_loops
from benchmarking.graph_optima import read_problem
from benchmarking.runs import say
from mfslam import se2
from mfslam.commands.optimize import KERNEL_SIGMAS
from mfslam.graph.batch import Solution, solve
from mfslam.graph.chordal import chordal_start
from mfslam.graph.robust import dead_reckoning, solve_robust
from mfslam.metrics import ate
from mfslam.pose_graphs.data import Problem
from mfslam.types import BoolArray, FloatArray, MfslamError

KERNELS = ("none", *KERNEL_SIGMAS)
KINDS: tuple[Kind, ...] = ("uniform", "grouped")
SHARES = (0.1, 0.2, 0.5)
SEEDS = (1, 2, 3)  # of the false loops that gnc gets; kernels get those of the first
_ITERATIONS = 10  # of a kernel: false loops make a graph dense, and what is stuck by then stays stuck
NOISE = 0.1  # of ringCity's sigmas, which the file states and does not have


def outlier_table(folder: Path) -> Iterator[list[str]]:
    gnc = [f"gnc, seed {seed}" for seed in SEEDS]
    yield ["graph", "false loops", *(f"{kernel}, seed {SEEDS[0]}" for kernel in KERNELS), *gnc,
           "gnc, worst over clean", "gnc CPU s, median"]  # fmt: skip
    for name, (problem, truth) in _graphs(folder).items():
        clean = solve(problem, _start(problem)).world_T_pose
        reference = clean if truth is None else truth
        without = _row(problem, clean, reference, name, None, 0.0)
        yield without
        for kind in KINDS:
            for share in SHARES:
                row = _row(problem, clean, reference, name, kind, share)
                row[-2] = _worst(row[-2 - len(SEEDS) : -2], without[-3])
                yield row


def _row(
    problem: Problem, clean: FloatArray, reference: FloatArray, name: str, kind: Kind | None, share: float
) -> list[str]:
    """Kernels on the first draw, gnc on all; without a kind, the graph as it is."""
    say(f"{name}, {share:.0%} {kind or 'false loops'}")
    draws = [
        with_false_loops(problem, clean, share if kind else 0.0, kind or "uniform", seed) for seed in SEEDS
    ]
    first, false = draws[0]
    kernels = [_cell(reference, _solve(first, kernel), false) for kernel in KERNELS]
    robust = [(_solve(graph, "gnc"), wrong) for graph, wrong in (draws if kind else draws[:1])]
    cells = [_cell(reference, solution, wrong) for solution, wrong in robust]
    if kind is None:
        cells *= len(SEEDS)
    cpu_s = float(np.median([solution.cpu_s for solution, _ in robust if solution is not None]))
    what = f"{share:.0%} {kind} ({int(false.sum()):,})" if kind else "none"
    return [name, what, *kernels, *cells, "-", f"{cpu_s:.1f}"]


def _worst(cells: list[str], clean: str) -> str:
    """Largest ATE of the seeds over that of the graph without false loops, to the table's millimetre."""
    errors = [float(cell.split()[0]) if cell != "failed" else np.inf for cell in cells]
    before, worst = float(clean.split()[0]), max(errors)
    if before == 0:
        return "1.00" if worst == 0 else "inf"
    return f"{worst / before:.2f}"


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
    rng = np.random.default_rng(SEEDS[0])
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
