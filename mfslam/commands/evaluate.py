"""`mfslam evaluate`: how good trajectories and graphs of any program are."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from mfslam.evaluation.page import evaluation_page
from mfslam.evaluation.scores import (
    Score,
    against_graph_truth,
    against_relations,
    against_truth,
    differences,
)
from mfslam.evaluation.tables import as_text, score_tables
from mfslam.metrics import read_relations
from mfslam.output import check_outputs, json_text, write_atomically
from mfslam.output.results import Result, read_graph_truth, read_result
from mfslam.types import MfslamError

LONGEST_S = 1e6  # between stamps that are taken for one


def run(args: argparse.Namespace) -> int:
    check_outputs(args.output, args.json, args.list)
    if args.rpe_step < 1:
        raise MfslamError(f"--rpe-step: expected at least 1 pose, got {args.rpe_step}")
    for name, value in (("--tolerance", args.tolerance), ("--max-difference", args.max_difference)):
        if not 0.0 <= value <= LONGEST_S:
            raise MfslamError(f"{name}: expected 0 to {LONGEST_S:g} s, got {value:g}")
    results = [
        replace(read_result(path), name=name)
        for path, name in zip(args.results, _names(args.results), strict=True)
    ]
    scores = _scores(results, args)
    found = differences(scores)
    tables = score_tables(scores, found)
    truth = args.relations or args.truth or args.graph_truth
    if args.json is not None:
        content = {
            "against": str(truth),
            "results": [score.as_json() for score in scores],
            "differences": found,
        }
        write_atomically(args.json, json_text(content).encode())
    if args.list is not None:
        write_atomically(args.list, _list(scores).encode())
    if args.output is not None:
        x_label = "time (s)" if args.graph_truth is None else "vertex"
        write_atomically(args.output, evaluation_page(scores, tables, truth.name, x_label).encode())
    if not args.quiet:
        print("\n\n".join(f"{title}\n{as_text(rows)}" for title, rows in tables))
        for path in (args.output, args.list):
            if path is not None:
                print(f"written  {path}")
    return 0


def _names(paths: list[Path]) -> list[str]:
    """The last part of each path, more of it where two would be alike."""
    for depth in range(1, 8):
        names = ["/".join(path.resolve().parts[-depth:]) for path in paths]
        if len(set(names)) == len(names):
            return names
    return [f"{n + 1}: {path}" for n, path in enumerate(paths)]


def _scores(results: list[Result], args: argparse.Namespace) -> list[Score]:
    if args.relations is not None:
        relations = read_relations(args.relations)
        return [against_relations(result, relations, args.tolerance) for result in results]
    if args.truth is not None:
        truth = read_result(args.truth)
        return [against_truth(result, truth, args.max_difference, args.rpe_step) for result in results]
    graph_truth = read_graph_truth(args.graph_truth)
    return [against_graph_truth(result, graph_truth, args.rpe_step) for result in results]


def _list(scores: list[Score]) -> str:
    """CSV of every single error; entry: number of the relation or true pose from 0, in its file's or time's order."""
    lines = ["result,entry,error_m,error_deg"]
    for score in scores:
        errors = score.relations or score.poses
        if errors is None:
            continue
        entries = errors.matched.nonzero()[0].tolist()
        rows = zip(entries, errors.m.tolist(), errors.deg.tolist(), strict=True)
        name = score.name.replace('"', "'")
        lines += [f'"{name}",{entry},{m:.9f},{deg:.9f}' for entry, m, deg in rows]
    return "\n".join(lines) + "\n"
