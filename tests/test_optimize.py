"""Pose graphs from files: best known optima, certificates, false loops, one pose at a time."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import gtsam
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mfslam import se2
from mfslam.cli import main
from mfslam.graph.batch import kernel_weights, solve
from mfslam.graph.certificate import certify
from mfslam.graph.chordal import chordal_start
from mfslam.graph.incremental import solve_incrementally
from mfslam.graph.minorant import isotropic_part
from mfslam.graph.robust import dead_reckoning, solve_robust
from mfslam.output.graph_reader import read_graph
from mfslam.pose_graphs.data import GraphFile, Problem, components, problem_of
from mfslam.types import FloatArray, MfslamError

GTSAM_DATA = Path(gtsam.__file__).parent / "Data"


def ring(count: int = 40, noise: float = 0.02, seed: int = 0, loops: int = 12) -> tuple[Problem, FloatArray]:
    """A robot that drives round twice, with loops between the rounds; and the truth."""
    rng = np.random.default_rng(seed)
    angle = 4.0 * np.pi * np.arange(count) / count
    truth = np.column_stack([5.0 * np.cos(angle), 5.0 * np.sin(angle), se2.wrap(angle + 0.5 * np.pi)])
    chain = np.arange(count - 1)
    first = np.sort(rng.choice(count // 2 - 1, loops, replace=False))
    i, j = np.concatenate([chain, first]), np.concatenate([chain + 1, first + count // 2])
    sigmas = np.array([1.0, 1.0, 0.5]) * max(noise, 1e-3)
    exact = se2.between(truth[i], truth[j])
    measured = se2.compose(
        exact, se2.exp(rng.normal(0.0, 1.0, exact.shape) * noise * np.array([1.0, 1.0, 0.5]))
    )
    information = np.tile(np.diag(sigmas**-2.0), (len(i), 1, 1))
    graph = GraphFile(np.arange(count), truth, frozenset(), i, j, measured, information)
    return problem_of(graph)[0], truth


def run(*args: str | Path) -> int:
    return main([str(arg) for arg in args])


@pytest.mark.parametrize(
    ("name", "chi2"),
    [
        ("intel.g2o", 546.463),
        ("manhattan/manhattanOlson3500.g2o", 146.079),
        ("M3500.g2o", 137.915),
        ("city10000.g2o", 511.987),
        ("w100.graph", 1.138),
        ("w10000.graph", 289.735),
        ("ringCity/ringCity.g2o", 0.0),  # the file has no noise: its own poses fit all of its edges
        ("M3500b_toro_order.g2o", 2055.38),
    ],
)
def test_best_known_optima_are_reached_and_certified(
    shared_data: Path, tmp_path: Path, name: str, chi2: float
) -> None:
    path = GTSAM_DATA / name if name.startswith("w") else shared_data / "pose_graphs" / name
    found = tmp_path / "found.json"
    assert run("optimize", path, "--json", found, "-q") == 0
    result = json.loads(found.read_text())
    assert result["chi2"] == pytest.approx(chi2, rel=1e-4, abs=1e-6 if chi2 == 0 else 5e-4)
    assert result["certificate"]["certified"]
    assert result["certificate"]["lower_bound"] <= result["chi2"]


def test_chi2_is_twice_gtsams_error(shared_data: Path) -> None:
    path = shared_data / "pose_graphs" / "intel.g2o"
    factors, values = gtsam.readG2o(str(path))
    problem, _ = problem_of(read_graph(path))
    assert problem.chi2(problem.world_T_pose).sum() == pytest.approx(2.0 * factors.error(values), rel=1e-9)


def test_a_wrong_optimum_is_not_certified(shared_data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = shared_data / "pose_graphs" / "M3500b_toro_order.g2o"
    assert run("optimize", path, "--start", "file") == 0
    assert "not certified: the dual matrix has a negative eigenvalue" in capsys.readouterr().out


@pytest.mark.parametrize("seed", range(4))
def test_the_bound_is_below_chi2_of_any_poses(seed: int) -> None:
    problem, truth = ring(seed=seed)
    best = solve(problem, truth)
    certificate = certify(problem, best.world_T_pose)
    assert certificate.certified
    assert certificate.lower_bound is not None
    rng = np.random.default_rng(seed)
    for spread in (0.01, 0.3, 3.0):
        other = solve(
            problem, se2.compose(truth, rng.normal(0.0, spread, truth.shape) * ~problem.held[:, None])
        )
        assert problem.chi2(other.world_T_pose).sum() >= certificate.lower_bound


@given(st.lists(st.floats(-3.0, 3.0), min_size=9, max_size=9))
def test_the_isotropic_part_is_below_the_matrix(entries: list[float]) -> None:
    root = np.array(entries).reshape(3, 3)
    information = (root.T @ root)[None]
    tau, kappa, _ = isotropic_part(information)
    rest = information[0] - np.diag([tau[0], tau[0], kappa[0]])
    assert np.linalg.eigvalsh(rest)[0] >= -1e-9 * max(1.0, np.abs(information).max())


def test_chordal_start_of_an_exact_graph_is_exact_from_any_guess() -> None:
    problem, truth = ring(noise=0.0)
    lost = Problem(np.vstack([truth[:1], np.zeros((len(truth) - 1, 3))]), problem.i, problem.j, problem.i_T_j, problem.information, problem.held)  # fmt: skip
    start = chordal_start(lost)
    assert start is not None
    assert np.abs(se2.between(start, truth)).max() < 1e-9


def test_one_pose_at_a_time_comes_to_the_same_poses() -> None:
    problem, truth = ring()
    run_ = solve_incrementally(problem)
    batch = solve(problem, truth)
    assert np.abs(se2.between(run_.world_T_pose, batch.world_T_pose)).max() < 1e-3
    assert len(run_.update_s) == problem.size


def test_false_loops_are_refused_and_change_nothing() -> None:
    problem, truth = ring(count=80, loops=30)
    clean = solve(problem, truth).world_T_pose
    rng = np.random.default_rng(1)
    count = 30
    i = rng.integers(0, 35, count)
    spoiled = Problem(
        truth,
        np.concatenate([problem.i, i]),
        np.concatenate([problem.j, i + rng.integers(8, 40, count)]),
        np.vstack(
            [problem.i_T_j, np.column_stack([rng.normal(0, 0.5, (count, 2)), rng.uniform(-3, 3, count)])]
        ),
        np.concatenate([problem.information, problem.information[-1:].repeat(count, axis=0)]),
        problem.held,
    )
    solved = solve_robust(spoiled, truth)
    assert (solved.weights[-count:] == 0).all()
    assert solved.weights[:-count].mean() > 0.95
    assert np.abs(se2.between(solved.world_T_pose, clean)).max() < 0.05


def test_dead_reckoning_follows_edges_of_either_direction() -> None:
    problem, truth = ring(noise=0.0)
    back = np.arange(len(problem.i)) % 2 == 1
    turned = Problem(
        np.zeros_like(truth) + truth[0],
        np.where(back, problem.j, problem.i),
        np.where(back, problem.i, problem.j),
        np.where(back[:, None], se2.inverse(problem.i_T_j), problem.i_T_j),
        problem.information,
        problem.held,
    )
    reckoned = dead_reckoning(turned)
    assert reckoned is not None
    assert np.abs(se2.between(reckoned, truth)).max() < 1e-9
    assert dead_reckoning(turned.part(problem.j != 5)) is None


@pytest.mark.parametrize("kernel", ["huber", "cauchy", "geman-mcclure", "dcs", "tls"])
def test_kernel_weights_are_those_of_gtsam(kernel: str) -> None:
    problem, truth = ring(noise=0.5)
    name = {"geman-mcclure": "GemanMcClure", "dcs": "DCS", "tls": "TruncatedLeastSquares"}.get(
        kernel, kernel.capitalize()
    )
    scale = 2.0
    theirs = getattr(gtsam.noiseModel.mEstimator, name).Create(scale**2 if kernel == "dcs" else scale)
    ours = kernel_weights(problem, truth, (kernel, scale))
    chi2 = problem.chi2(truth)
    for n in np.flatnonzero(~problem.chain()):
        assert ours[n] == pytest.approx(theirs.weight(np.sqrt(chi2[n])), abs=1e-12)


# --- the command -------------------------------------------------------------------------------------

TRIANGLE = """VERTEX_SE2 0 0 0 0
VERTEX_SE2 1 1 0 0
VERTEX_SE2 2 1 1 1.5
EDGE_SE2 0 1 1 0 0 10 0 0 10 0 10
EDGE_SE2 1 2 0 1 1.5 10 0 0 10 0 10
EDGE_SE2 0 2 1 1.1 1.5 10 0 0 10 0 10
"""


def optimized(tmp_path: Path, text: str, *more: str) -> dict[str, Any]:
    path, found = tmp_path / "g.g2o", tmp_path / "found.json"
    path.write_text(text)
    assert run("optimize", path, "-o", tmp_path / "out.g2o", "--json", found, *more) == 0
    return dict(json.loads(found.read_text()))


def test_the_solved_graph_is_written_at_full_precision_and_solves_at_once(tmp_path: Path) -> None:
    first = optimized(tmp_path, TRIANGLE)
    again = optimized(tmp_path, (tmp_path / "out.g2o").read_text())
    assert again["iterations"] <= 1
    assert again["chi2"] == pytest.approx(first["chi2"], rel=1e-9)


def test_parts_without_a_common_edge_are_named_and_solved(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    apart = (
        TRIANGLE
        + "VERTEX_SE2 7 9 9 0\nVERTEX_SE2 8 9 9 0\nEDGE_SE2 7 8 0 2 0 1 0 0 1 0 1\nVERTEX_SE2 11 5 5 5\n"
    )
    result = optimized(tmp_path, apart)
    assert result["parts"] == 3
    assert (
        "3 parts that no edge joins (3 of vertex 0, 2 of vertex 7, 1 of vertex 11)" in capsys.readouterr().out
    )
    solved = read_graph(tmp_path / "out.g2o")
    np.testing.assert_allclose(solved.world_T_pose[3:5, :2], [[9.0, 9.0], [9.0, 11.0]], atol=1e-6)
    assert components(solved).tolist() == [0, 0, 0, 1, 1, 2]


def test_fixed_vertices_stay_and_priors_hold_the_graph(tmp_path: Path) -> None:
    result = optimized(tmp_path, TRIANGLE + "FIX 0 2\n")
    assert result["held"] == [0, 2]
    np.testing.assert_allclose(
        read_graph(tmp_path / "out.g2o").world_T_pose[[0, 2]], [[0, 0, 0], [1, 1, 1.5]], atol=1e-9
    )
    result = optimized(tmp_path, TRIANGLE + "EDGE_PRIOR_SE2 1 4 4 1 10 0 0 10 0 10\n")
    assert result["held"] == []
    assert result["certificate"]["certified"]
    np.testing.assert_allclose(read_graph(tmp_path / "out.g2o").world_T_pose[1], [4, 4, 1], atol=1e-3)


@pytest.mark.parametrize(
    "how", [["--robust", "gnc"], ["--robust", "cauchy"], ["--incremental"], ["--start", "chordal"]]
)
def test_every_way_to_solve_comes_to_the_end(tmp_path: Path, how: list[str]) -> None:
    assert optimized(tmp_path, TRIANGLE, *how)["chi2"] < 0.1


@pytest.mark.parametrize(
    ("text", "how", "message"),
    [
        (TRIANGLE + "VERTEX_SE2 3 0 0 0\nEDGE_SE2 2 3 0 0 0 0 0 0 0 0 5\n", [], "g.g2o: vertex 3: its edges leave a direction open"),
        (TRIANGLE + "VERTEX_SE2 3 0 0 0\nEDGE_SE2 3 4 0 0 0 1 0 0 1 0 5\n", [], "g.g2o:8: vertex 4 is nowhere"),
        ("", [], "holds no pose"),
    ],
)  # fmt: skip
def test_bad_graphs_get_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, how: list[str], message: str
) -> None:
    path = tmp_path / "g.g2o"
    path.write_text(text)
    assert run("optimize", path, *how) == 1
    told = capsys.readouterr().err
    assert message in told
    assert told.count("\n") == 1


def test_incremental_needs_an_edge_to_what_came_before() -> None:
    problem, _ = ring()
    with pytest.raises(MfslamError, match=r"pose number 5 .* has no edge to a pose before it"):
        solve_incrementally(problem.part(problem.j != 5))
