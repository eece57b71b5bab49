"""What is believed between refinements, on a small graph whose truth is known."""

from __future__ import annotations

import numpy as np
import pytest

from mfslam import se2
from mfslam.config import Config
from mfslam.graph import PoseGraph
from mfslam.live.belief import Belief, Refined
from mfslam.types import Edge

STEP = np.array([0.5, 0.0, 2.0 * np.pi / 40])  # 40 steps make a round
KNOWN = 40


def truth(count):
    poses = [np.zeros(3)]
    for _ in range(count - 1):
        poses.append(se2.compose(poses[-1], STEP))
    return np.array(poses)


def drive(graph, first, last):
    """Steps that are too long, and a loop to the round before at every fourth keyframe."""
    wrong, loose, sure = STEP + np.array([0.02, 0.0, 0.0]), 100.0 * np.eye(3), 1e4 * np.eye(3)
    for k in range(first, last):
        graph.add_keyframe(wrong, [Edge("scan", k - 1, k, wrong, loose)])
        if k >= KNOWN and k % 4 == 0:
            graph.add_edge(Edge("loop", k - KNOWN, k, np.zeros(3), sure))


@pytest.fixture
def graph():
    out = PoseGraph(Config().graph)
    out.add_first(np.zeros(3))
    drive(out, 1, KNOWN)
    return out


def refined_of(poses):
    return Refined(poses, poses, np.eye(3), None)


def worst_m(poses, wanted):
    return float(np.hypot(*(poses - wanted)[:, :2].T).max())


def test_later_keyframes_hang_on_the_refined_ones_by_their_own_loops(graph):
    belief = Belief()
    belief.take(refined_of(truth(KNOWN)), graph.numbers_in_use())
    drive(graph, KNOWN, 2 * KNOWN)
    poses, wanted = belief.keyframes(graph), truth(2 * KNOWN)
    assert worst_m(graph.poses(), wanted) > 0.15  # alone it cannot know better
    assert worst_m(poses[:KNOWN], wanted[:KNOWN]) < 0.05
    assert worst_m(poses, wanted) < 0.08
    assert np.array_equal(belief.keyframes(graph), poses)


def test_without_a_refinement_it_is_the_graph(graph):
    assert np.array_equal(Belief().keyframes(graph), graph.rough_poses())


def test_refined_keyframes_give_way_to_a_loop_that_contradicts_them(graph):
    belief, bent = Belief(), truth(KNOWN) + np.linspace(0.0, 1.0, KNOWN)[:, None] * np.array([0.4, 0.0, 0.0])
    belief.take(refined_of(bent), graph.numbers_in_use())
    drive(graph, KNOWN, KNOWN + 1)  # closes the round
    poses = belief.keyframes(graph)
    assert np.hypot(*poses[KNOWN, :2]) < 0.02
    assert worst_m(poses[:KNOWN], truth(KNOWN)) < 0.2 < worst_m(bent, truth(KNOWN))


def test_a_loop_that_was_believed_and_is_taken_out_bends_nothing_any_more(graph):
    wrong = graph.add_edge(Edge("loop", 0, 20, np.zeros(3), 1e4 * np.eye(3)))
    bent = np.concatenate([np.zeros((21, 3)), truth(KNOWN - 21)])
    belief = Belief()
    belief.take(refined_of(bent), graph.numbers_in_use())
    assert np.array_equal(belief.keyframes(graph), bent)
    graph.remove_edges([wrong])
    drive(graph, KNOWN, KNOWN + 1)
    assert worst_m(belief.keyframes(graph), truth(KNOWN + 1)) < 0.6 < worst_m(bent, truth(KNOWN))


def test_a_refinement_that_refused_a_loop_goes_on_when_the_graph_takes_it_out(graph):
    wrong = graph.add_edge(Edge("loop", 0, 20, np.zeros(3), 1e4 * np.eye(3)))
    belief = Belief()
    belief.take(refined_of(truth(KNOWN)), graph.numbers_in_use())
    graph.remove_edges([wrong])
    assert np.array_equal(belief.keyframes(graph), truth(KNOWN))


@pytest.mark.parametrize("refined", [False, True])
def test_who_asks_what_is_believed_changes_nothing_of_what_is_found(refined):
    found = []
    for asks in (False, True):
        rng, graph, belief = np.random.default_rng(0), PoseGraph(Config().graph), Belief()
        graph.add_first(np.zeros(3))
        drive(graph, 1, KNOWN)
        if refined:
            belief.take(refined_of(truth(KNOWN)), graph.numbers_in_use())
        for k in range(KNOWN, 2 * KNOWN):
            drive(graph, k, k + 1)
            graph.add_edge(Edge("loop", k - KNOWN, k, rng.normal(0.0, 0.2, 3), 300.0 * np.eye(3)))
            if asks:
                belief.keyframes(graph)
            if k % 3 == 0:
                graph.rough_poses()
        found.append(graph.poses())
    assert np.array_equal(*found)
