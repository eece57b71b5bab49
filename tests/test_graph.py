"""The pose graph in closed form: chains, loops, edges taken out again, failures of the solver, false loops."""

from __future__ import annotations

import math
from dataclasses import replace

import gtsam
import numpy as np
import pytest

from factors.noise import ABSOLUTE_FLOOR, RELATIVE_FLOOR
from mfslam import se2
from mfslam.config import GraphConfig
from mfslam.graph import PoseGraph, least_squares
from mfslam.graph.edges import EdgeArrays
from mfslam.graph.gtsam_graph import gtsam_graph
from mfslam.graph.least_squares import PoseSolver
from mfslam.types import Edge, MfslamError

STEP = np.array([1.0, 0.1, 0.2])
HELD = np.full(3, 1e-6)  # sigmas of the first pose in gtsam
INFORMATION = np.diag([400.0, 100.0, 900.0])
TURNED = se2.adjoint(np.array([0.3, -0.2, 0.5]))
FULL = TURNED.T @ INFORMATION @ TURNED  # with all its off-diagonal terms


def chain(steps, information=INFORMATION):
    """A graph of one edge per step, each saying what was driven."""
    graph = PoseGraph(GraphConfig())
    graph.add_first(np.zeros(3))
    for k, step in enumerate(steps):
        graph.add_keyframe(step, [Edge("scan", k, k + 1, step, information)])
    return graph


def dead_reckoned(steps):
    poses = [np.zeros(3)]
    for step in steps:
        poses.append(se2.compose(poses[-1], step))
    return np.array(poses)


def square(count=40, drift=0.0):
    """Steps once around a square, ``drift`` rad too much in each."""
    steps = np.tile([1.0, 0.0, drift], (count, 1))
    steps[count // 4 - 1 :: count // 4, 2] += 0.5 * math.pi
    return steps


def assert_poses(poses, truth, atol):
    np.testing.assert_allclose(se2.between(truth, poses), 0.0, atol=atol)


def test_without_a_loop_the_chain_is_dead_reckoning():
    steps = np.tile(STEP, (100, 1))
    graph = chain(steps)
    assert len(graph) == 101
    np.testing.assert_allclose(graph.poses(), dead_reckoned(steps), atol=1e-9)
    graph.optimize(graph.live_edges())
    np.testing.assert_allclose(graph.poses(), dead_reckoned(steps), atol=1e-6)


def test_poses_are_a_copy():
    graph = chain([STEP])
    graph.poses()[:] = 7.0
    np.testing.assert_allclose(graph.poses()[1], STEP, atol=1e-12)


def test_a_loop_on_a_line_is_shared_by_variance():
    """Two steps of 1 m that are sure to 0.1 and 0.2 m, and a loop that says 2.5 m, sure to 0.1 m: the
    surplus of 0.5 m splits over 0.01, 0.04 and 0.01 m^2."""
    graph = PoseGraph(GraphConfig(loop_kernel_sigmas=1e6))
    graph.add_first(np.zeros(3))
    east = np.array([1.0, 0.0, 0.0])
    graph.add_keyframe(east, [Edge("scan", 0, 1, east, np.diag([100.0, 1e4, 1e4]))])
    graph.add_keyframe(east, [Edge("scan", 1, 2, east, np.diag([25.0, 1e4, 1e4]))])
    graph.add_edge(Edge("loop", 0, 2, np.array([2.5, 0.0, 0.0]), np.diag([100.0, 1e4, 1e4])))
    np.testing.assert_allclose(graph.poses()[:, 0], [0.0, 1.0 + 0.5 / 6, 2.0 + 0.5 * 5 / 6], atol=1e-5)


def test_a_true_loop_takes_the_drift_out_of_a_square():
    graph = chain(square(drift=math.radians(0.3)))
    truth = dead_reckoned(square())
    before = np.hypot(*(graph.poses() - truth)[:, :2].T).max()
    graph.add_edge(Edge("loop", 0, 40, truth[40], 1e4 * np.eye(3)))
    online = np.hypot(*(graph.poses() - truth)[:, :2].T).max()
    edges = graph.optimize(graph.live_edges())
    final = np.hypot(*(graph.poses() - truth)[:, :2].T).max()
    assert before > 1.0 and online < 0.2 and final < 0.2
    assert [e.weight for e in edges if e.kind == "loop"] == [pytest.approx(1.0)]


def test_rough_poses_wait_for_a_loop_that_contradicts_them():
    truth = dead_reckoned(square())
    graph = chain(square())
    slight, grave = se2.compose(truth[20], [0.05, 0.0, 0.0]), se2.compose(truth[40], [0.0, 0.5, 0.0])
    graph.add_edge(Edge("loop", 0, 20, slight, 1e6 * np.eye(3)))
    np.testing.assert_array_equal(graph.rough_poses(), chain(square()).rough_poses())
    graph.add_edge(Edge("loop", 0, 40, grave, 1e6 * np.eye(3)))
    rough = graph.rough_poses()
    assert np.abs(rough[40] - truth[40]).max() > 0.2
    np.testing.assert_array_equal(rough, graph.poses())  # both loops are in by now
    other = chain(square())
    other.add_edge(Edge("loop", 0, 20, slight, 1e6 * np.eye(3)))
    assert np.abs(other.poses()[20] - truth[20]).max() > 0.01  # poses() leaves none out


def test_an_edge_taken_out_leaves_no_trace():
    steps = square(drift=math.radians(0.3))
    graph = chain(steps)
    number = graph.add_edge(Edge("loop", 0, 40, np.array([3.0, 0.0, 0.0]), 1e4 * np.eye(3)))
    assert np.abs(graph.poses()[40] - dead_reckoned(steps)[40]).max() > 0.5
    graph.remove_edges([number])
    np.testing.assert_allclose(graph.poses(), dead_reckoned(steps), atol=1e-4)
    assert len(graph.live_edges()) == 40 and len(graph.edges) == 41
    assert all(e.kind == "scan" for e in graph.optimize(graph.live_edges()))


def test_edges_added_after_one_was_taken_out_find_their_slots():
    graph = chain(square())
    first = graph.add_edge(Edge("loop", 0, 20, np.array([2.0, 0.0, 0.0]), 1e4 * np.eye(3)))
    graph.remove_edges([first])
    truth = dead_reckoned(square())
    second = graph.add_edge(Edge("loop", 0, 40, truth[40], 1e4 * np.eye(3)))
    third = graph.add_edge(Edge("loop", 1, 39, se2.between(truth[1], truth[39]), 1e4 * np.eye(3)))
    graph.poses()
    graph.remove_edges([third])
    assert [e for e in graph.live_edges() if e.kind == "loop"] == [graph.edges[second]]
    assert_poses(graph.poses(), truth, 1e-4)


@pytest.mark.parametrize(
    ("edge", "told"),
    [
        (Edge("loop", 0, 9, STEP, INFORMATION), "edge 0-9: no such keyframe"),
        (Edge("loop", -1, 1, STEP, INFORMATION), "edge -1-1: no such keyframe"),
        (Edge("loop", 0, 1, np.array([np.nan, 0.0, 0.0]), INFORMATION), "edge 0-1: .* not finite"),
        (Edge("loop", 0, 1, STEP, np.full((3, 3), np.inf)), "edge 0-1: .* not finite"),
    ],
)
def test_edges_that_would_corrupt_the_solver_are_refused(edge, told):
    graph = chain([STEP, STEP])
    with pytest.raises(MfslamError, match=told):
        graph.add_edge(edge)
    assert len(graph.edges) == 2
    np.testing.assert_allclose(graph.poses(), dead_reckoned([STEP, STEP]), atol=1e-9)


def test_false_loops_lose_their_weight_and_the_poses_do_not_notice():
    truth = dead_reckoned(square())
    graph = chain(square())
    rng = np.random.default_rng(3)
    for i, j in ((0, 40), (1, 39), (3, 37), (10, 30)):
        noise = se2.exp(rng.normal(0.0, [0.02, 0.02, 0.005]))
        measured = se2.compose(se2.between(truth[i], truth[j]), noise)
        graph.add_edge(Edge("loop", i, j, measured, np.diag([2500.0, 2500.0, 4e4])))
    false = {(2, 25): [0.0, 0.0, 0.0], (8, 33): [4.0, 1.0, 1.0], (12, 38): [0.5, -2.0, -1.5]}
    for (i, j), measured in false.items():
        graph.add_edge(Edge("loop", i, j, np.array(measured), np.diag([2500.0, 2500.0, 4e4])))
    edges = graph.optimize(graph.live_edges())
    for edge in edges:
        if edge.kind == "loop":
            assert (edge.weight < 0.5) == ((edge.i, edge.j) in false), edge
        else:
            assert edge.weight == 1.0
    assert np.hypot(*(graph.poses() - truth)[:, :2].T).max() < 0.2


def test_optimize_with_leaves_refused_loops_out_and_weighs_the_others():
    truth = dead_reckoned(square())
    graph = chain(square())
    steps = [Edge("scan", k, k + 1, s, INFORMATION) for k, s in enumerate(square())]
    good = Edge("loop", 0, 40, truth[40], INFORMATION)
    refused = Edge("loop", 3, 30, np.zeros(3), 1e6 * np.eye(3), weight=0.1)
    poor = Edge(
        "scan", 7, 9, se2.compose(se2.between(truth[7], truth[9]), np.array([0.0, 2.0, 0.0])), INFORMATION
    )
    out = graph.optimize_with([*steps, good, refused, poor])
    assert len(out) == len(steps) + 3
    assert out[-3].weight > 0.99 and out[-2] is refused
    # 2 m aside where 0.1 m is one sigma: the Cauchy kernel leaves 1 / (1 + 20^2 / 3^2)
    assert out[-1].weight == pytest.approx(1.0 / (1.0 + 400.0 / 9.0), rel=0.2)
    assert np.hypot(*(graph.poses() - truth)[:, :2].T).max() < 0.1


def test_the_solution_is_reached_from_the_poses_as_they_stand():
    """A refined solve of exact edges gives exact poses however bent the first graph was."""
    bent, truth = chain(square(drift=math.radians(0.5))), dead_reckoned(square())
    edges = [Edge("scan", k, k + 1, s, INFORMATION) for k, s in enumerate(square())]
    bent.optimize_with(edges)
    assert_poses(bent.poses(), truth, 1e-5)


def test_gyro_edges_straighten_a_chain_that_turns_too_far():
    steps = np.tile([1.0, 0.0, 0.1], (10, 1))
    graph = PoseGraph(GraphConfig())
    graph.add_first(np.zeros(3))
    for k, step in enumerate(steps):
        gyro = Edge("heading", k, k + 1, np.zeros(3), np.diag([0.0, 0.0, 1e8]))
        graph.add_keyframe(step, [Edge("scan", k, k + 1, step, np.diag([1e4, 1e4, 100.0])), gyro])
    graph.optimize(graph.live_edges())
    np.testing.assert_allclose(graph.poses()[:, 2], 0.0, atol=1e-3)


def test_a_compass_edge_holds_one_heading_and_nothing_else():
    graph = chain(np.tile([1.0, 0.0, 0.0], (4, 1)), np.diag([1e4, 1e4, 100.0]))
    graph.add_edge(Edge("heading", 4, 4, np.array([0.0, 0.0, 0.4]), np.diag([0.0, 0.0, 1e8])))
    graph.optimize(graph.live_edges())
    poses = graph.poses()
    assert poses[4, 2] == pytest.approx(0.4, abs=1e-3)
    # the lever of the turns costs nothing but the lateral springs: headings rise evenly
    assert np.all(np.diff(poses[:, 2]) > 0.05)


def test_singular_information_leaves_its_direction_to_the_others():
    """A corridor that runs 30 deg askew: the scan knows nothing along it, the wheels do."""
    axis = np.array([math.cos(math.pi / 6), math.sin(math.pi / 6), 0.0])
    across = np.array([-axis[1], axis[0], 0.0])
    blind = 1e5 * np.outer(across, across) + np.diag([0.0, 0.0, 1e6])
    measured = 5.0 * axis + 0.02 * across
    graph = PoseGraph(GraphConfig())
    graph.add_first(np.zeros(3))
    wheels = Edge("odometry", 0, 1, 1.0 * axis, np.diag([100.0, 100.0, 100.0]))
    graph.add_keyframe(1.0 * axis, [Edge("scan", 0, 1, measured, blind), wheels])
    graph.optimize(graph.live_edges())
    assert graph.poses()[1] @ axis == pytest.approx(1.0, abs=1e-3)
    assert graph.poses()[1] @ across == pytest.approx(0.02, abs=1e-3)


def test_the_same_edges_give_the_same_bits():
    results = []
    for _ in range(2):
        graph = chain(square(drift=0.004), FULL)
        graph.add_edge(Edge("loop", 0, 40, np.zeros(3), FULL))
        graph.optimize(graph.live_edges())
        results.append(graph.poses().tobytes())
    assert results[0] == results[1]


def there_and_back(count=60):
    """A drive ahead and back beside itself, its steps a little wrong, and the truth."""
    ahead = np.tile([0.5, 0.0, 0.0], (count, 1))
    turn = np.array([[0.0, 0.5, 0.5 * math.pi], [0.5, 0.0, 0.5 * math.pi]])
    steps = np.concatenate([ahead, turn, ahead])
    noise = np.random.default_rng(5).normal(0.0, [0.02, 0.01, 0.002], steps.shape)
    return se2.compose(steps, se2.exp(noise)), dead_reckoned(steps)


def drive_with_loops(steps, loops):
    """Keyframe by keyframe, each with its loops; what disputes took out and brought back."""
    graph = PoseGraph(GraphConfig())
    graph.add_first(np.zeros(3))
    taken_out, brought_back = [], []
    for k, step in enumerate(steps, start=1):
        graph.add_keyframe(step, [Edge("scan", k - 1, k, step, np.diag([2500.0, 1e4, 2.5e5]))])
        here = [loop for loop in loops if loop.j == k]
        for loop in here:
            graph.add_edge(loop)
        if here:
            out, back = graph.settle_disputes()
            taken_out += out
            brought_back += back
    return graph, taken_out, brought_back


def loop_between(truth, i, j, off=(0.0, 0.0, 0.0)):
    measured = se2.compose(np.array(off), se2.between(truth[i], truth[j]))
    return Edge("loop", i, j, measured, np.diag([2500.0, 2500.0, 4e4]))


def test_wrong_loops_that_tell_one_story_are_taken_out_while_mapping():
    """Four loops say that the way back is 5 m further on than it is; those that come later say otherwise."""
    steps, truth = there_and_back()
    wrong = [loop_between(truth, 50 - n, 70 + n, (5.0, 0.0, 0.0)) for n in range(4)]
    true = [loop_between(truth, 40 - 2 * n, 82 + 2 * n) for n in range(12)]
    graph, taken_out, _ = drive_with_loops(steps, [*wrong, *true])
    assert {(e.i, e.j) for e in taken_out} == {(e.i, e.j) for e in wrong}
    assert_poses(graph.poses(), drive_with_loops(steps, true)[0].poses(), 0.02)
    assert not {id(e) for e in wrong} & {id(e) for e in graph.live_edges()}
    assert len(graph.edges_to_judge()) == len(steps) + 16, "the last solve judges them once more"


def test_loops_that_were_outvoted_come_back():
    """The first true loops stand alone against a wrong story, until others agree with them."""
    steps, truth = there_and_back()
    first = [loop_between(truth, 52, 68), loop_between(truth, 51, 69)]
    wrong = [loop_between(truth, 49 - n, 71 + n, (5.0, 0.0, 0.0)) for n in range(5)]
    later = [loop_between(truth, 40 - 2 * n, 82 + 2 * n) for n in range(12)]
    graph, _, _ = drive_with_loops(steps, [*first, *wrong, *later])
    live = {id(e) for e in graph.live_edges()}
    assert all(id(e) in live for e in first) and not any(id(e) in live for e in wrong)
    assert_poses(graph.poses(), drive_with_loops(steps, [*first, *later])[0].poses(), 0.02)


def test_a_loop_in_use_is_satisfied_in_the_end():
    """Two loops that contradict each other by 0.4 m, neither outvoted: at most one of them stays."""
    steps, truth = there_and_back()
    graph, _, _ = drive_with_loops(steps, [])
    both = [loop_between(truth, 10, 110), loop_between(truth, 11, 109, (0.4, 0.0, 0.0))]
    edges = graph.optimize_satisfied(graph.optimize_with([*graph.live_edges(), *both]))
    kept = [e for e in edges if e.kind == "loop" and e.weight >= 0.5]
    off = [se2.between(e.i_T_j, se2.between(graph.poses()[e.i], graph.poses()[e.j])) for e in kept]
    assert len(kept) <= 1 and all(np.hypot(*x[:2]) < 0.2 for x in off)


def as_gtsam_gets_it(edge):
    """The edge with what `factors.noise_from_information` adds to its information."""
    floor = 0.0 if edge.kind == "heading" else max(ABSOLUTE_FLOOR, RELATIVE_FLOOR * edge.information.trace())
    return replace(edge, information=edge.information + floor * np.eye(3))


def noisy_drive():
    """There and back with gyro, compass and loops, one of them off by a metre."""
    steps, truth = there_and_back()
    graph, _, _ = drive_with_loops(steps, [])
    for k in range(0, len(steps), 7):
        turn = se2.between(truth[k], truth[k + 1])
        graph.add_edge(Edge("heading", k, k + 1, turn * [0.0, 0.0, 1.0], np.diag([0.0, 0.0, 1e6])))
    graph.add_edge(Edge("heading", 80, 80, truth[80] * [0.0, 0.0, 1.0], np.diag([0.0, 0.0, 1e4])))
    for n in range(0, 50, 5):
        off = (1.0, 0.0, 0.0) if n == 25 else (0.03 * math.sin(n), 0.02, 0.01)
        graph.add_edge(loop_between(truth, 55 - n, 66 + n, off))
    return graph


def test_steps_and_optimum_are_those_of_gtsam(monkeypatch):
    """Poses after a step of Gauss-Newton agree to 1e-7 m and rad, the least error to 1e-9 of itself."""
    monkeypatch.setattr(least_squares, "LEAST_DAMPING", 1e-12)
    graph = noisy_drive()
    edges = EdgeArrays(as_gtsam_gets_it(e) for e in graph.live_edges())
    solver, everything = PoseSolver(edges, len(graph)), np.ones(len(edges))
    factor_graph, values = gtsam_graph(graph.poses(), graph.live_edges(), 3.0)
    poses = graph.poses()
    optimizer = gtsam.GaussNewtonOptimizer(factor_graph, values)
    for _ in range(3):
        poses = solver.solve(poses, everything, edges.is_loop, 3.0, max_iterations=1)
        optimizer.iterate()
        of_gtsam = gtsam.utilities.extractPose2(optimizer.values())
        np.testing.assert_allclose(se2.between(of_gtsam, poses), 0.0, atol=1e-7)
    poses = solver.solve(poses, everything, edges.is_loop, 3.0, relative_gain=0.0)
    for _ in range(50):
        optimizer.iterate()
    chi2 = solver.chi2(poses)
    own = np.where(edges.is_loop, 9.0 * np.log1p(chi2 / 9.0), chi2).sum()
    assert own == pytest.approx(2.0 * factor_graph.error(optimizer.values()), rel=1e-9)


def test_a_graph_that_falls_apart_keeps_its_poses_finite():
    """Edges that leave a pose open do not blow the solution up."""
    graph = PoseGraph(GraphConfig())
    graph.add_first(np.zeros(3))
    graph.add_keyframe(STEP, [Edge("scan", 0, 1, STEP, np.zeros((3, 3)))])
    graph.add_keyframe(STEP, [Edge("scan", 1, 2, STEP, INFORMATION)])
    graph.add_edge(Edge("loop", 1, 2, se2.compose(STEP, [0.5, 0.0, 0.0]), INFORMATION))
    assert np.isfinite(graph.poses()).all()


def test_on_a_map_that_holds_a_loop_moves_the_latest_keyframes_alone():
    steps = square(200)
    truth = dead_reckoned(steps)
    graph = chain(steps[:190], FULL)
    graph.add_edge(Edge("loop", 0, 160, se2.between(truth[0], truth[160]), 1e4 * np.eye(3)))
    before = graph.poses()  # all are solved for
    for k in range(190, 200):
        drifted = steps[k] + np.array([0.02, 0.03, 0.0])
        graph.add_keyframe(drifted, [Edge("scan", k, k + 1, drifted, FULL)])
    graph.add_edge(Edge("loop", 0, 200, se2.between(truth[0], truth[200]), 1e6 * np.eye(3)))
    rough = graph.rough_poses()
    np.testing.assert_array_equal(rough[:191], before)
    assert_poses(rough[200], truth[200], 0.01)
    assert np.any(graph.poses()[:191] != before)
