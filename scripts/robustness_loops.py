#!/usr/bin/env python3
"""What false loops do to a map: they are put into the graphs of real and simulated logs, while mapping.

The graph of a log is built up again keyframe by keyframe, with its own loops and as many false ones as asked for, each
when its later keyframe is reached; then it is solved for good. Error before and after, against the same graph
without false loops: relations error of real logs (hand-verified relative poses), ATE of simulated ones.

- alone: any two keyframes, any pose within 5 m, as sure as a true one.
- grouped: five in a row that tell one and the same wrong story about two stretches of path.

    scripts/robustness_loops.py ../logs/fr079.clf.gz office:7          # a log with its .relations beside it; a world
    scripts/robustness_loops.py LOG ... --shares 0.1,0.5 --seeds 2 --markdown docs/robustness.md
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from benchmarking.page import as_markdown, replace_section
from benchmarking.runs import relations_beside
from robustness import table_text

from drivers.logs import default_presets, open_log
from drivers.simulator import laser_model, load_world, simulate, without_pose
from drivers.simulator.demo import demo_robot
from mfslam import se2
from mfslam.graph import PoseGraph
from mfslam.metrics import ate, read_relations, relations_error
from mfslam.settings import load, preset_path
from mfslam.slam import Slam
from mfslam.trajectory import spread_corrections
from mfslam.types import Edge, FloatArray, IntArray, Message, MfslamError

HEAD = ["log", "loops", "false", "kind", "error m", "clean m", "final / clean", "online / clean", "false kept",
        "true lost"]  # fmt: skip
GROUP, FAR_M, LEAST_APART = 5, 5.0, 30


@dataclass(eq=False)
class Run:
    """The graph of a log as it was built up, and how wrong a trajectory (S, 3) of its scans is, m."""

    name: str
    edges: list[Edge]
    local_T_body: FloatArray  # (S, 3)
    keyframes: IntArray
    error_m: Callable[[FloatArray], float]


def recorded(name: str) -> Run:
    """Maps a log, or a simulated world, and keeps its graph before the final solve."""
    path = Path(name)
    if not path.is_file():
        simulation = simulate(load_world(name), demo_robot(), laser_model("fast", (0.1, 0.0, 0.0)), seed=1)
        truth = simulation.truth_world_T_body
        slam = fed(Slam(load([preset_path("generic")])), (without_pose(m) for m in simulation.messages))
        return run_of(name, slam, lambda poses: ate(truth[: len(poses)], poses).translation_m.rmse)
    relations = read_relations(relations_beside(path))
    config = load([preset_path(preset) for preset in default_presets(name)])
    with open_log(name, config) as log:
        slam = fed(Slam(config), log)
    stamps_ns = np.array([scan.stamp_ns for scan in slam.scans], dtype=np.int64)
    return run_of(
        path.name.split(".")[0], slam,
        lambda poses: relations_error(stamps_ns, poses, relations).translation_m.mean,
    )  # fmt: skip


def fed(slam: Slam, messages: Iterable[Message]) -> Slam:
    for message in messages:
        slam.feed(message)
    return slam


def run_of(name: str, slam: Slam, error_m: Callable[[FloatArray], float]) -> Run:
    local = np.array([step.local_T_body for step in slam.steps])
    keyframes = np.array([k.scan_index for k in slam.keyframes], dtype=np.int64)
    return Run(name, slam.graph.edges_to_judge(), local, keyframes, error_m)


# --- false loops -----------------------------------------------------------------------------------------


def false_loops(
    run: Run, truth: FloatArray, count: int, grouped: bool, rng: np.random.Generator
) -> list[Edge]:
    """Loops off by more than 1 m or 0.3 rad from ``truth`` (K, 3), a trajectory of the keyframes."""
    true_loops = [e for e in run.edges if e.kind == "loop"]
    local = run.local_T_body[run.keyframes]
    out: list[Edge] = []
    while len(out) < count:
        size = min(GROUP, count - len(out)) if grouped else 1
        i, j = sorted(int(k) for k in rng.integers(0, len(local) - 2 * GROUP, 2))
        if j - i < LEAST_APART:
            continue
        wrong = np.array([*rng.uniform(-FAR_M, FAR_M, 2), rng.uniform(-np.pi, np.pi)])
        off = se2.between(se2.between(truth[i], truth[j]), wrong)
        if np.hypot(off[0], off[1]) < 1.0 and abs(off[2]) < 0.3:
            continue
        information = true_loops[int(rng.integers(len(true_loops)))].information
        for n in range(size):
            a, b = i + 2 * n, j + 2 * n
            moved = se2.compose(
                se2.between(local[a], local[i]), se2.compose(wrong, se2.between(local[j], local[b]))
            )
            out.append(Edge("loop", a, b, moved, information))
    return out


# --- building up the graph again -----------------------------------------------------------------------------


@dataclass(frozen=True)
class Built:
    online_m: float
    final_m: float
    false_kept: int
    true_lost: int
    world_T_keyframe: FloatArray


def built(run: Run, false: list[Edge]) -> Built:
    """The graph keyframe by keyframe, loops as they come, and the final solve."""
    graph = PoseGraph(load([]).graph)
    by_end: dict[int, list[Edge]] = {}
    for edge in [*run.edges, *false]:
        by_end.setdefault(max(edge.i, edge.j), []).append(edge)
    graph.add_first(np.zeros(3))
    for k in range(1, len(run.keyframes)):
        here = by_end.get(k, [])
        scan = next(e for e in here if e.kind == "scan" and e.i == k - 1)
        graph.add_keyframe(scan.i_T_j, [e for e in here if e.kind != "loop"])
        loops = [e for e in here if e.kind == "loop"]
        for edge in loops:
            graph.add_edge(edge)
        if loops:
            graph.rough_poses()
            graph.settle_disputes()
    online = graph.poses()
    edges = graph.optimize_satisfied(graph.optimize_with(graph.optimize(graph.edges_to_judge())))
    key = {(e.i, e.j, *e.i_T_j) for e in false}
    kept = [e for e in edges if e.kind == "loop" and e.weight >= 0.5]
    false_kept = sum((e.i, e.j, *e.i_T_j) in key for e in kept)
    true_count = sum(e.kind == "loop" for e in run.edges)
    return Built(
        _error(run, online), _error(run, graph.poses()), false_kept, true_count - (len(kept) - false_kept),
        graph.poses(),
    )  # fmt: skip


def _error(run: Run, world_T_keyframe: FloatArray) -> float:
    return run.error_m(spread_corrections(run.local_T_body, run.keyframes, world_T_keyframe))


def rows_of(run: Run, shares: list[float], seeds: int) -> list[list[str]]:
    clean = built(run, [])
    count = sum(e.kind == "loop" for e in run.edges)
    print(
        f"{run.name}: {count} loops, clean {clean.final_m:.4f} m, online {clean.online_m:.4f} m",
        file=sys.stderr,
    )
    out = []
    for grouped in (False, True):
        for share in shares:
            many = []
            for seed in range(seeds):
                false = false_loops(
                    run, clean.world_T_keyframe, round(share * count), grouped, np.random.default_rng(seed)
                )
                many.append(built(run, false))
            final = float(np.mean([b.final_m for b in many]))
            online = float(np.mean([b.online_m for b in many]))
            out.append([
                run.name, f"{count:,}", f"{share:.0%}", "grouped" if grouped else "alone", f"{final:.4f}",
                f"{clean.final_m:.4f}", f"{final / clean.final_m:.2f}", f"{online / clean.online_m:.2f}",
                f"{sum(b.false_kept for b in many)} of {round(share * count) * seeds}",
                f"{sum(b.true_lost - clean.true_lost for b in many)} of {count * seeds}",
            ])  # fmt: skip
            print("  ".join(out[-1]), file=sys.stderr, flush=True)
    return out


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("logs", nargs="+", help="logs with relations beside them, or simulated worlds")
    parser.add_argument("--shares", default="0.1,0.2,0.5", help="false loops per true one")
    parser.add_argument("--seeds", type=int, default=1, help="so many draws of each")
    parser.add_argument("--markdown", type=Path, help="put the table into this page")
    args = parser.parse_args()
    shares = [float(word) for word in args.shares.split(",")]
    table = [row for name in args.logs for row in rows_of(recorded(name), shares, args.seeds)]
    print(table_text(table, HEAD))
    if args.markdown is not None:
        replace_section(args.markdown, "loops", as_markdown([HEAD, *table]))
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except MfslamError as error:
        sys.exit(f"robustness_loops: {error}")
