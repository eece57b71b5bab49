"""Bounds on chi2 of pose graphs whose edges weigh errors differently by direction, and what they rest on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import csc_array

from mfslam import se2
from mfslam.graph.batch import solve
from mfslam.graph.certificate import certify
from mfslam.graph.minorant import minorant
from mfslam.graph.symmetric_factors import SymmetricFactors, elimination_order
from mfslam.pose_graphs.data import GraphFile, Problem, problem_of
from mfslam.types import FloatArray

SIGMAS = np.array([0.02, 0.02, 0.01])


def ring(seed: int, across: float = 10.0, count: int = 40, twice: bool = False) -> tuple[Problem, FloatArray]:
    """Two laps of a circle, loops between them, and the truth. Every edge is ``across`` times less sure in one direction,
    turned and sheared into the heading by seed; the steps are there ``twice``, the second time alike in all directions."""
    rng = np.random.default_rng(seed)
    angle = 4.0 * np.pi * np.arange(count) / count
    truth = np.column_stack([5.0 * np.cos(angle), 5.0 * np.sin(angle), se2.wrap(angle + 0.5 * np.pi)])
    chain, first = np.arange(count - 1), np.arange(0, count // 2 - 1, 2)
    i = np.concatenate([chain, first, chain[: len(chain) * twice]])
    j = np.concatenate([chain + 1, first + count // 2, chain[: len(chain) * twice] + 1])
    sigmas = np.tile(SIGMAS, (len(i), 1))
    sigmas[: len(chain) + len(first), 1] *= across
    turns = np.column_stack([rng.normal(0.0, 0.2, (len(i), 2)), rng.uniform(-3.0, 3.0, len(i))])
    frame = se2.adjoint(turns)
    information = np.einsum("eba,eb,ebc->eac", frame, sigmas**-2.0, frame)
    noise = np.linalg.solve(frame, (rng.normal(size=(len(i), 3)) * sigmas)[..., None])[..., 0]
    information[len(chain) + len(first) :] = np.diag(SIGMAS**-2.0)
    noise[len(chain) + len(first) :] = rng.normal(size=(len(chain) * twice, 3)) * SIGMAS
    measured = se2.compose(se2.between(truth[i], truth[j]), se2.exp(noise))
    graph = GraphFile(np.arange(count), truth, frozenset(), i, j, measured, information)
    return problem_of(graph)[0], truth


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("twice", [False, True])
def test_the_form_is_below_chi2_everywhere_and_touches_it_at_the_solution(seed: int, twice: bool) -> None:
    problem, truth = ring(seed, twice=twice)
    best = solve(problem, truth).world_T_pose
    below = minorant(problem, best)
    assert below is not None
    assert not below.is_plain

    def value(poses: FloatArray) -> float:
        x = below.form.unknowns(poses)
        return float(np.vdot(x, below.form.q @ x).real) + below.constant

    chi2 = float(problem.chi2(best).sum())
    assert value(best) == pytest.approx(chi2, rel=1e-3)
    rng = np.random.default_rng(seed)
    for spread in (1e-3, 0.01, 0.1, 1.0, 10.0):
        for _ in range(20):
            move = rng.normal(0.0, spread, best.shape) * ~problem.held[:, None]
            there = se2.compose(best, move)
            assert value(there) <= float(problem.chi2(there).sum()) * (1.0 + 1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_each_edge_by_itself_is_above_its_form(seed: int) -> None:
    problem, truth = ring(seed)
    best = solve(problem, truth).world_T_pose
    rng = np.random.default_rng(seed)
    for n in range(0, len(problem.i), 7):
        one = problem.part(np.arange(len(problem.i)) == n)
        below = minorant(one, best)
        assert below is not None
        for spread in (0.05, 0.5, 5.0):
            for _ in range(30):
                there = se2.compose(best, rng.normal(0.0, spread, best.shape) * ~problem.held[:, None])
                x = below.form.unknowns(there)
                bound = float(np.vdot(x, below.form.q @ x).real) + below.constant
                assert bound <= float(one.chi2(there).sum()) + 1e-6 * abs(below.constant)


@pytest.mark.parametrize("twice", [False, True])
def test_edges_that_weigh_errors_by_direction_are_certified(twice: bool) -> None:
    problem, truth = ring(1, across=3.0, twice=twice)
    certificate = certify(problem, solve(problem, truth).world_T_pose)
    assert certificate.certified, certificate.reason
    assert certificate.lower_bound is not None
    assert certificate.lower_bound <= certificate.chi2


def test_a_wrong_optimum_of_such_edges_is_not_certified() -> None:
    problem, truth = ring(2, across=3.0)
    turned = truth.copy()
    turned[:, 2] += np.linspace(0.0, 2.0 * np.pi, len(truth))  # one turn too many
    wrong = solve(problem, turned).world_T_pose
    best = float(problem.chi2(solve(problem, truth).world_T_pose).sum())
    certificate = certify(problem, wrong)
    assert certificate.chi2 > 2.0 * best
    assert not certificate.certified
    assert certificate.lower_bound is None or certificate.lower_bound <= best


def test_edges_that_know_nothing_in_a_direction_are_not_certified_and_it_is_said_why() -> None:
    problem, truth = ring(3, across=1e4)
    wrong = se2.exp(np.random.default_rng(3).normal(0.0, 0.2, problem.i_T_j.shape))
    torn = replace(problem, i_T_j=se2.compose(problem.i_T_j, wrong))  # edges that contradict one another
    certificate = certify(torn, solve(torn, truth).world_T_pose)
    assert not certificate.certified
    assert "in one direction" in certificate.reason


@pytest.mark.parametrize("is_complex", [False, True])
def test_factors_solve_and_tell_definiteness(is_complex: bool) -> None:
    rng = np.random.default_rng(0)
    size = 30
    root = rng.normal(size=(size, size)) + (1j * rng.normal(size=(size, size)) if is_complex else 0.0)
    dense = root.conj().T @ root
    order = rng.permutation(size)
    factors = SymmetricFactors(csc_array(dense), order)
    right = rng.normal(size=size) + 1j * rng.normal(size=size)
    assert factors.is_positive
    np.testing.assert_allclose(dense @ factors.solve(right), right, atol=1e-8)
    least = float(np.linalg.eigvalsh(dense)[0])
    assert SymmetricFactors(csc_array(dense - 0.99 * least * np.eye(size)), order).is_positive
    assert not SymmetricFactors(csc_array(dense - 1.01 * least * np.eye(size)), order).is_positive


@pytest.mark.parametrize("edges", [[], [(0, 1)], [(0, 1), (1, 2), (5, 6)]])
def test_every_unknown_has_a_place_in_the_order(edges: list[tuple[int, int]]) -> None:
    i, j = np.array(edges, dtype=np.int64).reshape(-1, 2).T
    assert sorted(elimination_order(i, j, 8).tolist()) == list(range(8))
    assert elimination_order(i[:0], j[:0], 0).tolist() == []
    assert elimination_order(i[:0], j[:0], 1).tolist() == [0]


def test_a_prior_alone_is_certified() -> None:
    problem, truth = ring(0)
    prior = replace(
        problem,
        i=np.append(problem.i, problem.size),
        j=np.append(problem.j, 0),
        i_T_j=np.vstack([problem.i_T_j, truth[0]]),
        information=np.concatenate([problem.information, np.eye(3)[None]]),
        held=np.zeros(problem.size, dtype=np.bool_),
    )
    certificate = certify(prior, solve(prior, truth).world_T_pose)
    assert certificate.lower_bound is not None
