"""Our layer beside plain gtsam in one process, and a graph of 100,000 poses."""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import gtsam
import numpy as np

from benchmarking.graph_optima import GRAPHS, read_problem
from benchmarking.runs import say
from mfslam import se2
from mfslam.graph.batch import solve
from mfslam.graph.incremental import RELINEARIZE_THRESHOLD, solve_incrementally
from mfslam.output.g2o import graph_file_text
from mfslam.pose_graphs.data import GraphFile, Problem

REPEATS = 3
LARGE = 100_000


def speed_table(folder: Path) -> Iterator[list[str]]:
    yield ["job", "mfslam", "plain gtsam", "mfslam over plain", "chi2", "chi2 plain"]
    for name in ("city10000", "w10000"):
        say(f"{name}, batch")
        problem = read_problem(folder, GRAPHS[name][0])
        yield _row(f"batch, {name}", problem, _batch, _plain_batch)
    say("manhattan, one pose at a time")
    problem = read_problem(folder, GRAPHS["manhattanOlson3500"][0])
    yield _row("iSAM2 one pose at a time, manhattanOlson3500", problem, _incremental, _plain_incremental)
    say(f"{LARGE:,} poses")
    yield _large()


def _row(
    job: str, problem: Problem, ours: Callable[[Problem], float], plain: Callable[[Problem], float]
) -> list[str]:
    """Medians of alternating runs, from the file's own poses."""
    times: tuple[list[float], list[float]] = ([], [])
    chi2 = [0.0, 0.0]
    for _ in range(REPEATS):
        for which, solver in enumerate((ours, plain)):
            began = time.process_time()
            chi2[which] = solver(problem)
            times[which].append(time.process_time() - began)
    a, b = (float(np.median(t)) for t in times)
    return [
        job,
        f"{a:.2f}",
        f"{b:.2f}",
        f"{100.0 * (a / b - 1.0):+.0f} %",
        f"{chi2[0]:.3f}",
        f"{chi2[1]:.3f}",
    ]


def _batch(problem: Problem) -> float:
    return solve(problem, problem.world_T_pose).chi2_steps[-1]


def _plain_graph(problem: Problem) -> gtsam.NonlinearFactorGraph:
    """As a user of gtsam writes it."""
    graph = gtsam.NonlinearFactorGraph()
    for i, j, pose, information in zip(problem.i, problem.j, problem.i_T_j, problem.information, strict=True):
        noise = gtsam.noiseModel.Gaussian.Information(information)
        graph.add(gtsam.BetweenFactorPose2(i, j, gtsam.Pose2(*pose), noise))
    prior = gtsam.noiseModel.Diagonal.Sigmas(np.full(3, 1e-4))
    graph.add(gtsam.PriorFactorPose2(0, gtsam.Pose2(*problem.world_T_pose[0]), prior))
    return graph


def _plain_batch(problem: Problem) -> float:
    graph, values = _plain_graph(problem), gtsam.Values()
    for key, pose in enumerate(problem.world_T_pose):
        values.insert(key, gtsam.Pose2(*pose))
    return float(2.0 * graph.error(gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()))


def _incremental(problem: Problem) -> float:
    return float(problem.chi2(solve_incrementally(problem).world_T_pose).sum())


def _plain_incremental(problem: Problem) -> float:
    graph = _plain_graph(problem)
    newest = np.maximum(problem.i, problem.j)
    params = gtsam.ISAM2Params()
    params.setRelinearizeThreshold(RELINEARIZE_THRESHOLD)
    params.relinearizeSkip = 1
    isam = gtsam.ISAM2(params)
    last = gtsam.Pose2(*problem.world_T_pose[0])
    by_pose: list[list[int]] = [[] for _ in range(problem.size)]
    for e, n in enumerate(newest.tolist()):
        by_pose[n].append(e)
    for n in range(problem.size):
        new, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        guess = last
        for e in by_pose[n]:
            new.add(graph.at(e))
            if problem.i[e] == n - 1:
                guess = last.compose(gtsam.Pose2(*problem.i_T_j[e]))
        if n == 0:
            new.add(graph.at(len(problem.i)))
        values.insert(n, guess)
        isam.update(new, values)
        last = isam.calculateEstimatePose2(n)
    for _ in range(3):
        isam.update()
    return float(2.0 * graph.error(isam.calculateEstimate()))


def _large() -> list[str]:
    """The whole command on a file of `LARGE` poses, certificate and writing included, in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        path, found = Path(folder) / "large.g2o", Path(folder) / "found.json"
        graph = synthetic(LARGE)
        path.write_text(graph_file_text(graph, np.ones(len(graph.i))))
        mfslam = str(Path(sys.executable).with_name("mfslam"))
        command = [mfslam, "optimize", str(path), "-o", str(Path(folder) / "out.g2o")]
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run([*command, "--json", str(found), "-q"], check=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        result = json.loads(found.read_text())
    cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    certified = "certified" if result["certificate"]["certified"] else "not certified"
    job = f"`mfslam optimize`, {len(graph.ids):,} poses, {len(graph.i):,} edges, {certified} (peak {after.ru_maxrss / 1024**2:.1f} GB)"
    return [job, f"{cpu_s:.1f}", "-", "-", f"{result['chi2']:.0f}", "-"]


def synthetic(count: int, seed: int = 0) -> GraphFile:
    """A robot that walks along the streets of a town, with a loop wherever it comes by again."""
    rng = np.random.default_rng(seed)
    side = max(int(np.sqrt(count) / 2), 5)
    truth = np.zeros((count, 3))
    x, y, d = side // 2, side // 2, 0
    for n in range(count):
        truth[n] = x, y, d * np.pi / 2
        if n % 5 == 4:
            d = int((d + rng.choice([-1, 0, 1])) % 4)
        while True:
            nx, ny = x + (1, 0, -1, 0)[d], y + (0, 1, 0, -1)[d]
            if 0 <= nx < side and 0 <= ny < side:
                break
            d = (d + 1) % 4
        x, y = nx, ny
    truth[:, 2] = se2.wrap(truth[:, 2])
    cell = np.round(truth[:, 0]).astype(np.int64) * side + np.round(truth[:, 1]).astype(np.int64)
    order = np.argsort(cell, kind="stable")
    same = cell[order][1:] == cell[order][:-1]
    i = np.concatenate([np.arange(count - 1), order[:-1][same]])
    j = np.concatenate([np.arange(1, count), order[1:][same]])
    keep = np.concatenate([np.ones(count - 1, dtype=bool), (j - i)[count - 1 :] > 1])
    i, j = i[keep], j[keep]
    sigmas = np.array([0.03, 0.03, 0.01])
    measured = se2.compose(
        se2.between(truth[i], truth[j]), se2.exp(rng.normal(0.0, 1.0, (len(i), 3)) * sigmas)
    )
    information = np.tile(np.diag(sigmas**-2.0), (len(i), 1, 1))
    guess = truth.copy()
    for n in range(1, count):
        guess[n] = se2.compose(guess[n - 1], measured[n - 1])
    return GraphFile(np.arange(count), guess, frozenset(), i, j, measured, information)
