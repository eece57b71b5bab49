"""Poses of every scan from those of the keyframes, poses at any instant, twists over intervals."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mfslam import se2
from mfslam.config import OdometryConfig
from mfslam.trajectory import (
    faster_than_driven,
    poses_at,
    spread_corrections,
    spread_covariances,
    twists_over,
)

TWIST = np.array([1.5, 0.0, -0.9])


def wander(count, seed=0):
    """A path of ``count`` poses that turns and backs up."""
    steps = np.random.default_rng(seed).normal([0.1, 0.0, 0.0], [0.1, 0.01, 0.1], (count - 1, 3))
    poses = [np.zeros(3)]
    for step in steps:
        poses.append(se2.compose(poses[-1], se2.exp(step)))
    return np.array(poses)


def assert_poses(poses, truth, atol=1e-12):
    np.testing.assert_allclose(se2.between(truth, poses), 0.0, atol=atol)


@settings(max_examples=30, deadline=None, derandomize=True)
@given(st.integers(1, 60), st.integers(0, 10_000))
def test_nothing_changed_means_nothing_changes(count, seed):
    local = wander(count, seed)
    keyframes = np.unique(np.random.default_rng(seed).integers(0, count, 6))
    assert_poses(spread_corrections(local, keyframes, local[keyframes]), local)


@settings(max_examples=30, deadline=None, derandomize=True)
@given(st.integers(0, 10_000))
def test_keyframes_stand_where_the_graph_has_them(seed):
    rng = np.random.default_rng(seed)
    local, keyframes = wander(50, seed), np.array([0, 7, 8, 30, 49])
    world = se2.compose(local[keyframes], se2.exp(rng.normal(0.0, 0.3, (5, 3))))
    assert_poses(spread_corrections(local, keyframes, world)[keyframes], world)


def test_the_frame_of_the_front_end_does_not_matter():
    local, keyframes = wander(40), np.array([0, 12, 39])
    world = local[keyframes] + np.array([[0.0, 0.0, 0.0], [0.1, 0.2, 0.05], [0.3, -0.1, 0.1]])
    moved = se2.compose(np.array([5.0, -3.0, 2.5]), local)
    assert_poses(
        spread_corrections(moved, keyframes, world), spread_corrections(local, keyframes, world), 1e-11
    )


def test_a_correction_is_spread_evenly():
    """Straight ahead at 0.1 m a scan; the graph found 1.1 m instead of 1 m: each scan went 0.11 m."""
    local = np.zeros((11, 3))
    local[:, 0] = 0.1 * np.arange(11)
    poses = spread_corrections(local, np.array([0, 10]), np.array([[2.0, 1.0, 0.0], [3.1, 1.0, 0.0]]))
    np.testing.assert_allclose(poses[:, 0], 2.0 + 0.11 * np.arange(11), atol=1e-12)
    np.testing.assert_allclose(poses[:, 1:], np.tile([1.0, 0.0], (11, 1)), atol=1e-12)


def test_scans_before_the_first_and_after_the_last_keyframe_follow_them_rigidly():
    local, keyframes = wander(20), np.array([4, 12])
    world = se2.compose(np.array([1.0, 2.0, 0.5]), local[keyframes])
    poses = spread_corrections(local, keyframes, world)
    assert_poses(poses, se2.compose(np.array([1.0, 2.0, 0.5]), local))


@settings(max_examples=40, deadline=None, derandomize=True)
@given(st.lists(st.floats(0.0, 3.0), min_size=1, max_size=20), st.integers(2, 12))
def test_between_knots_the_twist_is_held(at_s, knots):
    times = np.linspace(0.0, 3.0, knots)
    poses = se2.exp(times[:, None] * TWIST)
    assert_poses(poses_at(times, poses, np.array(at_s)), se2.exp(np.array(at_s)[:, None] * TWIST), 1e-11)


def test_poses_are_held_at_both_ends():
    times, poses = np.array([1.0, 2.0, 3.0]), wander(3)
    assert_poses(poses_at(times, poses, np.array([-9.0, 1.0, 3.0, 99.0])), poses[[0, 0, 2, 2]])


def test_one_pose_is_everywhere():
    pose = np.array([[1.0, 2.0, 3.0]])
    assert_poses(poses_at(np.array([5.0]), pose, np.array([0.0, 5.0, 9.0])), np.repeat(pose, 3, axis=0))


def test_knots_at_one_instant_are_no_division_by_zero():
    """Stamps that go backwards are held: several scans then share an instant."""
    times, poses = np.array([0.0, 1.0, 1.0, 1.0, 2.0]), wander(5)
    found = poses_at(times, poses, np.array([0.5, 1.0, 1.5]))
    assert np.all(np.isfinite(found))
    assert_poses(found[1], poses[3])


@settings(max_examples=30, deadline=None, derandomize=True)
@given(st.floats(0.2, 2.0), st.floats(0.0, 0.7), st.sampled_from([0.01, 0.2]))
def test_the_twist_over_any_interval_is_the_one_driven(start_s, length_s, window_s):
    times = np.linspace(0.0, 3.0, 40)
    poses = se2.exp(times[:, None] * TWIST)
    ends = np.array([start_s + length_s])
    np.testing.assert_allclose(
        twists_over(times, poses, np.array([start_s]), ends, window_s)[0], TWIST, atol=1e-9
    )


def test_an_interval_is_widened_about_its_middle():
    """At rest until 1 s, then 2 m/s: an instant at 1 s sees half of each within its window."""
    times, poses = np.array([0.0, 1.0, 2.0]), np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
    instant = np.array([1.0])
    np.testing.assert_allclose(
        twists_over(times, poses, instant, instant, 0.4)[0], [1.0, 0.0, 0.0], atol=1e-12
    )


def test_no_time_is_no_motion():
    times, poses = np.array([0.0, 1.0]), wander(2)
    late = np.array([7.0])
    np.testing.assert_array_equal(twists_over(times, poses, late, late, 0.1), np.zeros((1, 3)))


def test_an_interval_at_the_end_is_measured_within_the_trajectory():
    times = np.linspace(0.0, 1.0, 11)
    poses = se2.exp(times[:, None] * TWIST)
    last = twists_over(times, poses, np.array([1.0]), np.array([1.1]), 0.2)[0]
    assert last == pytest.approx(TWIST, abs=1e-9)


def test_scans_before_a_keyframe_that_nothing_ties_hold_to_the_one_before():
    local, keyframes = wander(20), np.array([0, 8, 19])
    world = local[keyframes] + np.array([[0.0, 0.0, 0.0], [3.0, 2.0, 1.0], [3.0, 2.0, 1.0]])
    poses = spread_corrections(local, keyframes, world, np.array([False, True, False]))
    assert_poses(poses[:8], local[:8])
    assert_poses(poses[keyframes], world)


def test_covariances_between_keyframes_are_carried_and_bridged():
    world_T_body = np.column_stack([np.arange(5.0), np.zeros(5), np.full(5, 0.3)])
    world_T_body[:, 1] = np.tan(0.3) * world_T_body[:, 0]  # straight ahead
    keyframes = np.array([0, 4])
    sigmas = np.diag([0.01, 0.02, 0.003]) ** 2
    out = spread_covariances(np.stack([np.zeros((3, 3)), sigmas]), sigmas[None], world_T_body, keyframes)
    rotation = np.array([[np.cos(0.3), -np.sin(0.3)], [np.sin(0.3), np.cos(0.3)]])
    assert not out[0].any()
    np.testing.assert_allclose(out[4, :2, :2], rotation @ sigmas[:2, :2] @ rotation.T)  # in the world's axes
    # a quarter of the way: a quarter of the end's, its heading error acting over the way back, and the bridge
    behind_m = 3.0 / np.cos(0.3)
    body = rotation.T @ out[1, :2, :2] @ rotation
    bridge = 0.25 * 0.75
    assert body[0, 0] == pytest.approx((0.25 + bridge) * 0.01**2)
    assert body[1, 1] == pytest.approx((0.25 + bridge) * 0.02**2 + 0.25 * (behind_m * 0.003) ** 2)


def test_steps_that_no_robot_drives_in_their_time_are_told():
    times_s = np.array([0.0, 0.0, 0.1, 0.2, 0.2])
    poses = np.array([[0.0, 0, 0], [0.3, 0, 0], [0.6, 0, 0], [0.9, 0, 0], [0.9, 0, 0.2]])
    told = faster_than_driven(times_s, poses, OdometryConfig())
    assert told.tolist() == [True, False, False, True]
