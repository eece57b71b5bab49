"""Loop closure on exact scans: true loops are found, other rooms and look-alikes are not believed."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from mfslam import se2
from mfslam.config import Config, GraphConfig
from mfslam.deskew import deskew
from mfslam.graph import PoseGraph
from mfslam.loop_records import Candidate
from mfslam.loops import MOST_MISSES, Loop, LoopCloser
from mfslam.places import Place
from mfslam.step_records import Keyframe
from mfslam.types import Edge, Match
from mfslam.uncertainty import chi2_quantile
from tests.rooms import NO_PILLARS, laser, moving_scan

MODEL = laser(n_beams=360)
SIGMA = np.array([0.02, 0.02, 0.004])  # of one keyframe step


def box(x, y, w, h):
    return [[x, y, x + w, y], [x + w, y, x + w, y + h], [x + w, y + h, x, y + h], [x, y + h, x, y]]


# a corridor of 2 m around a block, each side with its own niches
RING = np.array(
    [
        *(*box(0, 0, 14, 10), *box(2, 2, 10, 6), *box(4.0, 0.0, 0.7, 0.3), *box(9.0, 1.8, 0.4, 0.2)),
        *(
            *box(13.6, 4.0, 0.4, 1.1),
            *box(6.0, 9.5, 1.4, 0.5),
            *box(0.0, 6.5, 0.3, 0.5),
            *box(0.0, 3.0, 0.5, 0.5),
        ),
    ]
)


def along(*corners, step_m=0.3):
    """Poses every ``step_m`` along a polyline, looking ahead."""
    poses = []
    for a, b in pairwise(corners):
        d = np.subtract(b, a)
        n = round(float(np.hypot(*d)) / step_m)
        heading = math.atan2(d[1], d[0])
        poses += [(*(np.add(a, d * k / n)), heading) for k in range(n)]
    return np.array(poses)


ROUND = along((1, 1), (13, 1), (13, 9), (1, 9), (1, 1), (8, 1))


def sense(world, pose):
    still = np.zeros(3)
    return deskew(moving_scan(world, NO_PILLARS, pose, still, MODEL), still, Config().deskew, 0.05)


def drive(truth, world_at, drift=(0.0, 0.0, 0.0), sigma=SIGMA, config=None, believe=True):
    """Feed keyframes whose local poses drift by ``drift`` a step; the loops believed and the closer."""
    config = config or Config()
    steps = se2.compose(se2.between(truth[:-1], truth[1:]), se2.exp(np.array(drift)))
    keyframes, graph = [], PoseGraph(GraphConfig())
    closer = LoopCloser(config, keyframes)
    local, found = np.zeros(3), []
    for k, pose in enumerate(truth):
        if k:
            local = se2.compose(local, steps[k - 1])
        keyframes.append(Keyframe(k, sense(world_at(k), pose), local))
        closer.add_keyframe()
        if not k:
            graph.add_first(np.zeros(3))
            continue
        edge = Edge("scan", k - 1, k, steps[k - 1], np.diag(np.asarray(sigma) ** -2.0))
        graph.add_keyframe(steps[k - 1], [edge])
        closer.skeleton.add_step([edge], graph.standing_poses())
        if closer.due():
            for loop in closer.search(graph.poses(), 0.01):
                found.append(loop)
                if believe:
                    graph.add_edge(loop.edge())
                    closer.skeleton.add_loop(loop.edge(), graph.standing_poses())
    return found, closer, graph


def errors(found, truth):
    off = np.array(
        [se2.between(se2.between(truth[f.i], truth[f.j]), f.match.ref_T_src) for f in found]
    ).reshape(-1, 3)
    return np.hypot(off[:, 0], off[:, 1]), np.abs(off[:, 2])


@pytest.fixture(scope="module")
def ring():
    return drive(ROUND, lambda k: RING, drift=(0.004, 0.0, 0.0015))


def test_a_ring_closes_and_the_drift_is_taken_out(ring):
    found, closer, graph = ring
    shift, turn = errors(found, ROUND)
    assert len(found) >= 2
    assert shift.max() < 0.1 and turn.max() < 0.03
    end = se2.between(se2.between(ROUND[0], ROUND[-1]), graph.poses()[-1])
    dead = se2.between(se2.between(ROUND[0], ROUND[-1]), closer.keyframes[-1].local_T_body)
    assert np.hypot(*dead[:2]) > 0.8
    assert np.hypot(*end[:2]) < 0.15


def test_what_was_done_is_counted(ring):
    found, closer, _ = ring
    assert closer.statistics.accepted == len(found)
    assert closer.statistics.places_tried >= len(found)
    assert closer.statistics.searches <= closer.travel_m[-1] / closer.config.every_m + 1


def test_a_loop_joins_an_old_place_with_the_newest(ring):
    found, closer, _ = ring
    for loop in found:
        assert closer.travel_m[loop.j] - closer.travel_m[loop.i] > 0.5 * closer.config.min_travel_m
        edge = loop.edge()
        assert (edge.kind, edge.i, edge.j) == ("loop", loop.i, loop.j)
        # no loop is surer than the places that it joins are straight
        assert np.linalg.eigvalsh(np.linalg.inv(edge.information))[-1] >= closer.config.sigma_floor_m**2


def test_straight_ahead_there_is_nothing_to_close():
    found, closer, _ = drive(ROUND[:40], lambda k: RING)
    assert found == [] and closer.statistics.accepted == 0


def test_loops_can_be_switched_off():
    config = Config(loops={"use": False})
    _, closer, _ = drive(ROUND[:60], lambda k: RING, config=config)
    assert closer.statistics.searches == 0


ROOM_A = np.array([*box(0, 0, 8, 6), *box(1, 1, 1.5, 0.6), *box(6, 4, 0.8, 1.4), *box(3.8, 5.2, 1.2, 0.8)])
ROOM_B = np.array([*box(-2, -1, 9, 9), *box(3, 6.2, 2.2, 0.7), *box(-1, 2, 0.5, 2.0), *box(5.5, 0, 0.7, 0.7)])
THERE = along((2.5, 2.5), (5.5, 2.5), (5.5, 3.5), (2.5, 3.5), (2.5, 2.5), (5.5, 2.5), (5.5, 3.5))


def test_another_room_at_the_same_spot_is_not_believed():
    """The estimate says the robot is back, but what it sees is another room: a floor above, say."""
    twice = np.concatenate([THERE, THERE])
    found, closer, _ = drive(twice, lambda k: ROOM_A if k < len(THERE) else ROOM_B, believe=False)
    # until the last 6 m were all driven in the new room, the query still holds the old one, and rightly fits
    changed = len(THERE) + round(closer.config.segment_m / 0.3)
    assert not [f for f in found if f.i < len(THERE) and f.j > changed]
    assert sum(closer.statistics.refused.values()) > 0
    assert max(closer._misses.values()) <= MOST_MISSES


def test_the_same_room_at_the_same_spot_is():
    twice = np.concatenate([THERE, THERE])
    found, _, _ = drive(twice, lambda k: ROOM_A)
    across = [f for f in found if f.i < len(THERE) <= f.j]
    assert across and errors(across, twice)[0].max() < 0.05


def look_alikes(count=5, pitch_m=5.0):
    """The same bay again and again along one wall of a corridor."""
    walls = box(-1.0, -1, count * pitch_m + 2, 3.5)
    for k in range(count):
        walls += [*box(pitch_m * k, 1, 0.8, 1.5), *box(pitch_m * k + 2.4, 1.0, 0.3, 0.3)]
    return np.array(walls)


def test_look_alikes_are_not_told_apart_by_guessing():
    """There and back past five equal bays while position drifts by more than half their pitch."""
    way = along((0.3, 0.0), (24.0, 0.0), (24.0, 0.6), (1.0, 0.6))
    found, closer, _ = drive(way, lambda k: look_alikes(), drift=(0.035, 0.0, 0.0), sigma=[0.2, 0.03, 0.004])
    shift, _ = errors(found, way)
    assert not np.any(shift > 1.0), "a loop to the wrong bay, 5 m on"
    assert closer.statistics.refused.get("ambiguous", 0) > 0


def test_loops_agree_when_they_tell_one_story():
    closer = LoopCloser(Config(), [])
    truth = along((0, 0), (12, 0), (12, 2), (0, 2))
    closer.keyframes = [Keyframe(k, sense(RING, ROUND[0]), pose) for k, pose in enumerate(truth)]
    closer.travel_m = type(closer.travel_m)("d", 0.3 * np.arange(len(truth)))

    def loop(i, j, off=(0.0, 0.0, 0.0)):
        measured = se2.compose(se2.between(truth[i], truth[j]), np.array(off))
        return Loop(i, j, Match(measured, np.eye(3), 1.0, 0.01, 5, True), 3.0, 0.8)

    assert closer._agree(loop(10, 75), loop(15, 70))
    both = (0.0, 3.0, 0.0)  # the same error in both: the one place taken for another
    assert closer._agree(loop(10, 75, both), loop(11, 73, both))
    assert not closer._agree(loop(10, 75), loop(15, 70, (0.8, 0.0, 0.0)))
    assert not closer._agree(loop(10, 75), loop(15, 70, (0.0, 0.0, 0.3)))
    assert not closer._agree(loop(10, 75), loop(10, 75)), "one scan is no second witness"


@pytest.mark.parametrize(("probability", "quantile"), [(0.95, 7.815), (0.999, 16.266)])
def test_chi2_of_three_degrees_of_freedom(probability, quantile):
    assert chi2_quantile(probability) == pytest.approx(quantile, abs=1e-3)


def test_the_place_of_a_keyframe_lies_on_its_side_of_a_tear():
    """The middle of a half segment that ends at a tear would be behind it."""
    closer = LoopCloser(Config(), [])
    closer.travel_m.extend([0.0, 1.0, 101.0, 102.0, 103.0])
    assert [closer._anchor(k) for k in range(5)] == [1, 1, 2, 4, 4]


def test_an_old_place_is_sought_where_it_may_be_seen_however_far_off_it_is_held_to_be():
    """After a tear nothing is known: the place is 40 m off, as it were, and may be here."""
    poses = np.array([*THERE, *THERE])
    closer = LoopCloser(Config(), [Keyframe(k, sense(ROOM_A, pose), pose) for k, pose in enumerate(poses)])
    for k in range(len(poses)):
        closer.travel_m.append(0.3 * k + (100.0 if k >= len(THERE) else 0.0))
    query = Place.of(closer.keyframes, closer._members(len(poses) - 1, trailing=True), len(poses) - 1)
    believed = poses + np.where(np.arange(len(poses)) < len(THERE), 0.0, 40.0)[:, None] * [1.0, 0.0, 0.0]
    candidate = Candidate(len(THERE) // 2, 100.0, math.pi)
    loop = closer._match(candidate, query, believed, 0.01)
    assert loop is not None
    off = se2.between(se2.between(poses[loop.i], poses[loop.j]), loop.match.ref_T_src)
    assert np.abs(off).max() < 0.05
    assert closer._match(Candidate(candidate.keyframe, 20.0, math.pi), query, believed, 0.01) is None


def test_over_a_tear_a_place_has_to_agree_more_closely():
    poses = np.array([*THERE, *THERE])
    closer = LoopCloser(Config(), [])
    closer.travel_m.extend(0.3 * k for k in range(len(poses)))
    for changed_m, over_a_tear, same in ((0.0, True, True), (0.35, False, True), (0.35, True, False)):
        # a cupboard was moved by so much
        moved = np.array(
            [
                *box(0, 0, 8, 6),
                *box(1, 1, 1.5, 0.6),
                *box(6, 4 - changed_m, 0.8, 1.4),
                *box(3.8, 5.2, 1.2, 0.8),
            ]
        )
        closer.keyframes = [
            Keyframe(k, sense(ROOM_A if k < len(THERE) else moved, pose), pose)
            for k, pose in enumerate(poses)
        ]
        closer._tears = type(closer._tears)("q", [len(THERE)] if over_a_tear else [])
        anchor, here = len(THERE) // 2, len(poses) - 1
        place = Place.of(closer.keyframes, closer._members(anchor, trailing=False), anchor)
        query = Place.of(closer.keyframes, closer._members(here, trailing=True), here)
        pose = se2.between(poses[anchor], poses[here])
        fit = closer._fit(place, query, pose, 1.0, True, 0.01)
        assert (fit.refused is None) is same
