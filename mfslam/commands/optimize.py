"""`mfslam optimize`: a pose graph file in, the best poses and how good they are out."""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mfslam.graph.batch import Solution, solve
from mfslam.graph.certificate import Certificate, certify
from mfslam.graph.chordal import chordal_start
from mfslam.graph.incremental import IncrementalRun, solve_incrementally
from mfslam.graph.robust import solve_robust
from mfslam.output import check_outputs, json_text, write_atomically
from mfslam.output.g2o import graph_file_text
from mfslam.output.graph_reader import read_graph
from mfslam.pose_graphs.data import GraphFile, Problem, components, problem_of
from mfslam.types import FloatArray, IntArray, MfslamError

KERNEL_SIGMAS = {
    "huber": 1.345,
    "cauchy": 2.3849,
    "geman-mcclure": 2.3849,
    "dcs": 1.0,
    "tls": 3.3682,
}  # of gtsam, tls of 99 %


@dataclass(frozen=True, eq=False)
class Outcome:
    """Everything that was found out of a graph."""

    graph: GraphFile
    problem: Problem
    start: str
    start_chi2: dict[str, float]
    solution: Solution
    incremental: IncrementalRun | None
    certificate: Certificate
    certificate_cpu_s: float
    cpu_s: float
    notes: list[str]

    @property
    def chi2(self) -> float:
        return float(self.solution.weights @ self.problem.chi2(self.solution.world_T_pose))


def run(args: argparse.Namespace) -> int:
    check_outputs(args.output, args.json)
    if args.kernel_sigmas is not None:
        if args.robust in ("none", "gnc"):
            raise MfslamError("--kernel-sigmas: only kernels have a scale (--robust huber, cauchy, ...)")
        if not 1e-6 <= args.kernel_sigmas <= 1e6:
            raise MfslamError(f"--kernel-sigmas: expected 1e-6 to 1e6 sigmas, got {args.kernel_sigmas:g}")
    outcome = optimize(args)
    if args.output is not None:
        solved = replace(outcome.graph, world_T_pose=outcome.solution.world_T_pose)
        write_atomically(args.output, graph_file_text(solved, outcome.solution.weights).encode())
    if args.json is not None:
        write_atomically(args.json, json_text(as_json(outcome, args.graph)).encode())
    if not args.quiet:
        print(text(outcome, args.output))
    return 0


def optimize(args: argparse.Namespace) -> Outcome:
    began = time.process_time()
    graph = read_graph(args.graph, args.information_order)
    problem, gauge = problem_of(graph)
    open_poses = graph.ids[problem.open_poses()]
    if len(open_poses):
        raise MfslamError(
            f"{args.graph}: vertex {open_poses[0]}: its edges leave a direction open, so no pose is the best one "
            f"({len(open_poses)} vertices so): give it an edge that knows x, y and theta, or FIX it"
        )
    notes = [*graph.notes, *_notes(graph, problem, gauge)]
    starts = {"file": problem.world_T_pose}
    if args.start != "file":
        chordal = chordal_start(problem)
        if chordal is not None:
            starts["chordal"] = chordal
        elif args.start == "chordal":
            notes.append("there is no chordal start: the edges leave a heading open")
    start_chi2 = {name: float(problem.chi2(poses).sum()) for name, poses in starts.items()}
    start = args.start if args.start in starts else min(start_chi2, key=lambda name: start_chi2[name])
    incremental = solve_incrementally(problem) if args.incremental else None
    solution = _solve(problem, starts[start], args.robust, args.kernel_sigmas, incremental)
    if incremental is not None:
        start = "incremental"
    solved_s = time.process_time() - began
    if not solution.arrived:
        notes.append(f"not arrived after {solution.iterations} iterations: chi2 was still falling")
    began = time.process_time()
    if args.no_certificate:
        certificate = Certificate(
            False, float(problem.chi2(solution.world_T_pose).sum()), None, "not asked for"
        )
    else:
        certificate = certify(problem.part(solution.weights >= 0.5), solution.world_T_pose)
    return Outcome(
        graph, problem, start, start_chi2, solution, incremental, certificate,
        time.process_time() - began, solved_s, notes,
    )  # fmt: skip


def _solve(
    problem: Problem, start: FloatArray, robust: str, sigmas: float | None, incremental: IncrementalRun | None
) -> Solution:
    if incremental is not None:
        return solve(problem, incremental.world_T_pose)
    if robust == "none":
        return solve(problem, start)
    if robust == "gnc":
        return solve_robust(problem, start)
    return solve(problem, start, kernel=(robust, sigmas or KERNEL_SIGMAS[robust]))


def _notes(graph: GraphFile, problem: Problem, gauge: IntArray) -> list[str]:
    notes = []
    if len(gauge) == 1:
        notes.append(
            f"vertex {graph.ids[gauge[0]]} is held where the file has it: nothing in the file holds the graph"
        )
    part = components(graph)
    sizes = np.bincount(part)
    if len(sizes) > 1:
        shown = [
            f"{size} of vertex {graph.ids[np.argmax(part == n)]}"
            for n, size in list(enumerate(sizes.tolist()))[:5]
        ]
        more = f" and {len(sizes) - 5} more" if len(sizes) > 5 else ""
        notes.append(
            f"the graph is in {len(sizes)} parts that no edge joins ({', '.join(shown)}{more}): "
            "each is solved by itself, its first vertex held"
        )
    weightless = int((~problem.information.any(axis=(1, 2))).sum())
    if weightless:
        notes.append(f"{weightless} edges have no information and say nothing")
    return notes


def as_json(outcome: Outcome, path: Path) -> dict[str, Any]:
    solution, graph = outcome.solution, outcome.graph
    held = graph.ids[outcome.problem.held]
    out: dict[str, Any] = {
        "graph": str(path),
        "vertices": len(graph.ids),
        "edges": len(graph.i),
        "held": held[:100],
        "parts": int(components(graph).max()) + 1,
        "start": outcome.start,
        "start_chi2": outcome.start_chi2,
        "chi2": outcome.chi2,
        "degrees_of_freedom": 3 * (int((solution.weights > 0).sum()) - int((~outcome.problem.held).sum())),
        "iterations": solution.iterations,
        "arrived": solution.arrived,
        "chi2_steps": solution.chi2_steps,
        "refused": [
            [int(graph.i[n]), int(graph.j[n])] for n in np.flatnonzero(solution.weights < 0.5).tolist()
        ],
        "cpu_s": {
            "read_and_solve": outcome.cpu_s,
            "solve": solution.cpu_s,
            "certificate": outcome.certificate_cpu_s,
        },
        "certificate": outcome.certificate.as_json(),
        "notes": outcome.notes,
    }
    if outcome.incremental is not None:
        out["incremental"] = update_times(outcome.incremental)
    return out


def update_times(run: IncrementalRun) -> dict[str, float]:
    ms = 1e3 * run.update_s
    return {
        "updates": len(ms),
        "total_s": float(ms.sum() * 1e-3),
        "mean_ms": float(ms.mean()),
        "median_ms": float(np.median(ms)),
        "p99_ms": float(np.percentile(ms, 99)),
        "max_ms": float(ms.max()),
    }


def text(outcome: Outcome, output: Path | None) -> str:
    solution, certificate = outcome.solution, outcome.certificate
    chi2 = f"{outcome.chi2:.6g}"
    at_start = ", ".join(f"{value:.6g} from the {name} start" for name, value in outcome.start_chi2.items())
    lines = [
        f"{len(outcome.graph.ids)} poses, {len(outcome.graph.i)} edges",
        f"start        {outcome.start} (chi2 {at_start})",
        f"chi2         {chi2} after {solution.iterations} iterations, {outcome.cpu_s:.2f} s of CPU with reading",
    ]
    refused = int((solution.weights < 0.5).sum())
    if refused:
        lines.append(f"refused      {refused} edges")
    if outcome.incremental is not None:
        times = update_times(outcome.incremental)
        lines.append(
            f"per update   mean {times['mean_ms']:.2f} ms, median {times['median_ms']:.2f}, 99 % {times['p99_ms']:.1f}, "
            f"longest {times['max_ms']:.0f} ms; chi2 {outcome.problem.chi2(outcome.incremental.world_T_pose).sum():.6g} at the end"
        )
    if certificate.certified:
        lines.append(
            f"certificate  the global optimum: no poses have a chi2 below {certificate.lower_bound:.6g}"
        )
    else:
        bound = "" if certificate.lower_bound is None else f" (lower bound {certificate.lower_bound:.4g})"
        lines.append(f"certificate  not certified: {certificate.reason}{bound}")
    lines += [f"note         {note}" for note in outcome.notes]
    if output is not None:
        lines.append(f"graph        {output}")
    return "\n".join(lines)
