"""Correlative search: lost poses are found again in a cast room, and nowhere else."""

from __future__ import annotations

import math

import numpy as np
import pytest
import rooms

from mfslam import se2
from mfslam.search import ELSEWHERE_M, MAX_POINTS, SearchMap, hypotheses, search, thin_evenly


@pytest.fixture(scope="module")
def place():
    points, _ = rooms.oriented_points(rooms.ROOM, rooms.ROOM_PILLARS, np.zeros(3), 0.01, seed=1)
    return SearchMap.of(points, np.zeros(2), 15.0, 0.1)


@pytest.mark.parametrize("truth", [[0.9, -0.7, 1.5], [-1.0, 0.5, -1.2], [0.3, 1.1, 0.7], [0.0, 0.0, 0.0]])
def test_a_kidnapped_robot_is_found(place, truth):
    """Window of 1.2 m and 100 deg, as the front end opens after a jump of the wheels."""
    pose_true = np.array(truth)
    points, _ = rooms.oriented_points(rooms.ROOM, rooms.ROOM_PILLARS, pose_true, 0.01, seed=2)
    pose, score = search(place, points, np.zeros(3), 1.2, math.radians(100.0), 0.4)
    error = se2.between(pose_true, pose)
    assert score > 0.5
    assert math.hypot(error[0], error[1]) < 0.12
    assert abs(error[2]) < math.radians(3.0)


def test_nothing_is_found_where_nothing_fits(place):
    scattered = np.random.default_rng(4).uniform(-6.0, 6.0, (200, 2))
    pose, score = search(place, scattered, np.array([0.1, 0.2, 0.3]), 0.6, 0.3, 0.6)
    assert score == 0.0
    np.testing.assert_array_equal(pose, [0.1, 0.2, 0.3])


def test_the_runner_up_lies_elsewhere_and_scores_less(place):
    points, _ = rooms.oriented_points(rooms.ROOM, rooms.ROOM_PILLARS, np.zeros(3), 0.01, seed=2)
    (best, score), (second, rival), *_ = hypotheses(place, points, np.zeros(3), 1.8, 0.3, 0.2, 0.2)
    assert math.hypot(second[0] - best[0], second[1] - best[1]) >= ELSEWHERE_M
    assert 0.2 * score < rival < 0.9 * score


def test_two_equal_rooms_are_two_answers():
    """A corridor with a niche every 4 m: the rival scores as well as the best."""
    niches = [[4.0 * k, 1.0, 4.0 * k, 1.6] for k in range(-3, 4)] + [
        [4.0 * k + 1, 1.0, 4.0 * k + 1, 1.6] for k in range(-3, 4)
    ]
    world = np.array([[-14.0, -1.0, 14.0, -1.0], *niches, [-14.0, 1.6, 14.0, 1.6]])
    here, _ = rooms.oriented_points(world, rooms.NO_PILLARS, np.zeros(3))
    place = SearchMap.of(here, np.zeros(2), 15.0, 0.1)
    near = here[np.abs(here[:, 0]) < 3.5]
    (_, score), (_, rival), *_ = hypotheses(place, near, np.zeros(3), 6.0, 0.05, 0.3, 0.7)
    assert rival > 0.7 * score


def test_turned_about_where_it_stands_is_another_answer():
    """A square room looks the same in four directions from its middle; all four are told, and no more."""
    corners = np.array([[-3.0, -3.0], [3.0, -3.0], [3.0, 3.0], [-3.0, 3.0]])
    world = np.hstack([corners, np.roll(corners, -1, axis=0)])
    here, _ = rooms.oriented_points(world, rooms.NO_PILLARS, np.zeros(3))
    place = SearchMap.of(here, np.zeros(2), 15.0, 0.1)
    found = hypotheses(place, here, np.zeros(3), 0.5, math.pi, 0.4)
    turned = sorted((math.degrees(pose[2]) + 45.0) % 360.0 - 45.0 for pose, _ in found)
    np.testing.assert_allclose(turned, [0, 90, 180, 270], atol=3)
    assert [score for _, score in found] == sorted((score for _, score in found), reverse=True)


def test_points_out_of_reach_are_no_part_of_a_place():
    points = np.array([[0.0, 0.0], [1.0, 1.0], [40.0, 0.0]])
    place = SearchMap.of(points, np.zeros(2), 5.0, 0.1)
    assert place.levels.shape[1:] == (16 + 17, 16 + 17)
    lonely = SearchMap.of(points + 100.0, np.zeros(2), 5.0, 0.1)
    assert lonely.levels[0].any(), "a place without any point in reach keeps one"


def test_thinning_is_even_and_keeps_both_ends():
    points = np.stack([np.arange(1000.0), np.zeros(1000)], axis=-1)
    thinned = thin_evenly(points, MAX_POINTS)
    assert len(thinned) == MAX_POINTS
    assert (thinned[0, 0], thinned[-1, 0]) == (0.0, 999.0)
    assert set(np.diff(thinned[:, 0])) <= {6.0, 7.0}
    np.testing.assert_array_equal(thin_evenly(points[:7], MAX_POINTS), points[:7])
