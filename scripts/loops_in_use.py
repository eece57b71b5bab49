#!/usr/bin/env python3
"""The loops that maps of real logs rest on: how many, whether the solution satisfies them, and whether one is false.

Every log is mapped with default settings. Where hand-verified relations lie beside it, each loop in use is held
against the nearest relation: from its first pose along the trajectory to where the relation begins, over it, and
on to its second pose, 6 m of trajectory at most.

    scripts/loops_in_use.py ../logs/*.clf.gz --markdown docs/robustness.md
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from benchmarking.page import as_markdown, replace_section
from benchmarking.runs import log_name, mapped_by_default, relations_beside
from robustness import table_text

from mfslam import se2
from mfslam.metrics import Relations, read_relations
from mfslam.output.summary import loops_in_use, travelled_m
from mfslam.slam import Solution
from mfslam.types import Edge, FloatArray, IntArray, MfslamError

HEAD = ["log", "m", "loops in use", "satisfied", "refused by the last solve", "taken out while mapping",
        "held against relations", "off, median", "off, largest"]  # fmt: skip
NEAR_M = 6.0  # of trajectory between a loop and the relation that it is held against


def row_of(path: Path) -> list[str]:
    slam, solution = mapped_by_default(path)
    told = loops_in_use(solution.world_T_body[solution.keyframes], solution.edges)
    share = told["in_use_satisfied_percent"]
    row = [
        log_name(path), f"{travelled_m(solution.world_T_body):,.0f}", f"{told['in_use']:,}",
        "-" if share is None else f"{share:.1f} %", f"{told['refused_by_the_last_solve']:,}",
        f"{slam.loops.statistics.taken_out:,}",
    ]  # fmt: skip
    relations = relations_beside(path)
    if not relations.is_file():
        return [*row, "-", "-", "-"]
    used = [e for e in solution.edges if e.kind == "loop" and e.weight >= 0.5]
    off = off_relations(used, solution, read_relations(relations))
    median, most = np.median(off, axis=0), np.max(off, axis=0)
    return [*row, f"{len(off):,}", *(f"{x[0]:.3f} m {x[1]:.2f} deg" for x in (median, most))]


def off_relations(loops: list[Edge], solution: Solution, relations: Relations) -> FloatArray:
    """(N, 2) m and deg by which loops are off what the relations say; those far from any are left out."""
    poses, keyframes = solution.world_T_body, solution.keyframes
    way_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])
    a, b = (_nearest(solution.stamps_ns, stamps) for stamps in (relations.a_ns, relations.b_ns))
    from_, to = np.concatenate([a, b]), np.concatenate([b, a])  # both ways round
    measured = np.concatenate([relations.a_T_b, se2.inverse(relations.a_T_b)])
    off = []
    for edge in loops:
        i, j = keyframes[edge.i], keyframes[edge.j]
        apart_m = np.abs(way_m[from_] - way_m[i]) + np.abs(way_m[to] - way_m[j])
        k = int(np.argmin(apart_m))
        if apart_m[k] <= NEAR_M:
            to_relation = se2.compose(se2.between(poses[i], poses[from_[k]]), measured[k])
            error = se2.between(se2.compose(to_relation, se2.between(poses[to[k]], poses[j])), edge.i_T_j)
            off.append((float(np.hypot(error[0], error[1])), float(np.degrees(abs(error[2])))))
    return np.array(off).reshape(-1, 2)


def _nearest(stamps_ns: IntArray, wanted_ns: IntArray) -> IntArray:
    order = np.argsort(stamps_ns, kind="stable")
    k = np.clip(np.searchsorted(stamps_ns[order], wanted_ns), 1, len(order) - 1)
    before, after = stamps_ns[order[k - 1]], stamps_ns[order[k]]
    return np.asarray(order[np.where(wanted_ns - before < after - wanted_ns, k - 1, k)])


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("logs", nargs="+", type=Path)
    parser.add_argument("--markdown", type=Path, help="put the table into this page")
    args = parser.parse_args()
    table = []
    for path in args.logs:
        table.append(row_of(path))
        print("  ".join(table[-1]), file=sys.stderr, flush=True)
    print(table_text(table, HEAD))
    if args.markdown is not None:
        replace_section(args.markdown, "loops in use", as_markdown([HEAD, *table]))
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except MfslamError as error:
        sys.exit(f"loops_in_use: {error}")
