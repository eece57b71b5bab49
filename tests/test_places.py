"""Places: what a stretch of path saw, and what another view agrees or disagrees with."""

from __future__ import annotations

import numpy as np
import pytest

from mfslam import se2
from mfslam.config import Config
from mfslam.deskew import deskew
from mfslam.places import Place, PlaceMemory
from mfslam.step_records import Keyframe
from tests.rooms import ROOM, ROOM_PILLARS, laser, moving_scan

STILL = np.zeros(3)


def keyframes_in(segments, poses, pillars=ROOM_PILLARS, local=None):
    model = laser()
    out = []
    for n, pose in enumerate(poses):
        cloud = deskew(moving_scan(segments, pillars, pose, STILL, model), STILL, Config().deskew, 0.05)
        out.append(Keyframe(n, cloud, pose if local is None else local[n]))
    return out


PATH = np.array([[-2.0, -1.0, 0.0], [-1.0, -0.8, 0.3], [0.0, -0.5, 0.6], [0.8, 0.6, 1.2]])


@pytest.fixture(scope="module")
def place():
    return Place.of(keyframes_in(ROOM, PATH), range(4), 1)


def test_the_surface_lies_on_the_walls(place):
    """In the anchor's frame: carried to the world every point is on a wall or on the pillar."""
    world = se2.transform(PATH[1], place.surface[:, :2])
    a, b = ROOM[:, :2], ROOM[:, 2:]
    along = b - a
    share = np.clip(np.sum((world[:, None] - a) * along, axis=2) / np.sum(along**2, axis=1), 0.0, 1.0)
    to_walls = np.linalg.norm(world[:, None] - (a + share[..., None] * along), axis=2).min(axis=1)
    to_pillar = np.abs(np.hypot(*(world - ROOM_PILLARS[0, :2]).T) - ROOM_PILLARS[0, 2])
    assert len(world) > 200
    assert np.percentile(np.minimum(to_walls, to_pillar), 95) < 0.03


def test_a_second_view_from_the_right_pose_agrees(place):
    here = np.array([0.5, -1.2, 2.0])
    query = Place.of(keyframes_in(ROOM, here[None]), range(1), 0)
    agree, seen = place.agreement(se2.between(PATH[1], here), query)
    assert agree > 0.97 and seen > 0.9


def test_a_view_from_a_wrong_pose_is_contradicted(place):
    here = np.array([0.5, -1.2, 2.0])
    query = Place.of(keyframes_in(ROOM, here[None]), range(1), 0)
    wrong = se2.compose(se2.between(PATH[1], here), np.array([0.8, 0.3, 0.5]))
    assert place.agreement(wrong, query)[0] < 0.8


def test_what_was_never_seen_is_neither(place):
    query = Place.of(keyframes_in(ROOM, PATH[:1]), range(1), 0)
    assert place.agreement(np.array([100.0, 0.0, 0.0]), query) == (0.0, 0.0)


def test_a_place_does_not_depend_on_the_local_frame(place):
    moved = se2.compose(np.array([40.0, -7.0, 2.0]), PATH)
    other = Place.of(keyframes_in(ROOM, PATH, local=moved), range(4), 1)
    assert other.surface.shape == place.surface.shape
    np.testing.assert_allclose(other.surface, place.surface, atol=1e-6)


def test_scans_that_saw_nothing_make_an_empty_place():
    nothing = np.array([[500.0, 500.0, 501.0, 500.0]])
    empty = Place.of(keyframes_in(nothing, PATH[:2], np.zeros((0, 3))), range(2), 0)
    assert len(empty.surface) == 0
    assert empty.agreement(np.zeros(3), empty) == (0.0, 0.0)


def test_a_place_is_made_once_and_the_least_used_is_forgotten():
    memory = PlaceMemory(keyframes_in(ROOM, PATH), capacity=2)
    first = memory.at(range(2), 0)
    second = memory.at(range(1, 3), 1)
    assert memory.at(range(2), 0) is first
    memory.at(range(2, 4), 2)  # the second was used longest ago
    assert memory.at(range(2), 0) is first
    assert memory.at(range(1, 3), 1) is not second
