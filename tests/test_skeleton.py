"""What a skeleton says of a graph is never surer than the graph's joint marginals, and it grows with the spots seen."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mfslam import se2
from mfslam.graph import GraphInformation
from mfslam.skeleton import LEAST_KNOWN, Skeleton
from mfslam.types import Edge

INFORMATION = np.diag([1e4, 1e4, 1e6])  # of a step and of a loop
KNOWN = 0.1, 0.03


class Drive:
    """The same steps and loops in a list of edges and in a `Skeleton`."""

    def __init__(self, steps, information=INFORMATION):
        self.skeleton, self.edges = Skeleton(*KNOWN), []
        poses = [np.zeros(3)]
        for step in steps:
            poses.append(se2.compose(poses[-1], step))
        self.poses = np.array(poses)
        self.information = information
        self.count = 1

    def until(self, keyframe):
        while self.count <= keyframe:
            i, j = self.count - 1, self.count
            edge = Edge("scan", i, j, se2.between(self.poses[i], self.poses[j]), self.information)
            self.edges.append(edge)
            self.skeleton.add_step([edge], self.poses[: j + 1])
            self.count += 1
        return self

    def loop(self, i, j):
        edge = Edge("loop", i, j, se2.between(self.poses[i], self.poses[j]), INFORMATION)
        self.edges.append(edge)
        self.skeleton.add_loop(edge, self.poses[: self.count])
        return edge

    def seen_from(self, j):
        """Sigmas of the knots, by their keyframe."""
        sigmas = self.skeleton.seen_from(j, self.poses[: self.count])
        return dict(zip(self.skeleton.knots.tolist(), np.transpose(sigmas), strict=True))

    def relative(self, i, j):
        return self.skeleton.relative_covariance(i, j, self.poses[: self.count])

    def exact(self, i, j):
        information = GraphInformation(self.poses[: self.count], self.edges)
        return information.relative_covariances(np.array([i]), np.array([j]))[0]


def straight(count):
    return np.tile([0.5, 0.0, 0.0], (count, 1))


def rounds(count, each=80):
    return np.tile(se2.exp(np.array([0.5, 0.0, 2.0 * math.pi / each])), (count, 1))


def tied_rounds(count, each=80):
    """Round and round, and where the robot does not know a knot beside it well, a loop ties it to that."""
    drive = Drive(rounds(count, each))
    for j in range(1, count + 1):
        drive.until(j)
        if j > each and j % 3 == 0:
            knots = drive.skeleton.knots[drive.skeleton.knots < j - each // 2]
            near = int(knots[np.argmin(np.hypot(*(drive.poses[knots, :2] - drive.poses[j, :2]).T))])
            if drive.seen_from(j)[near][0] > KNOWN[0]:
                drive.loop(near, j)
    return drive


def test_one_sees_oneself_surely():
    drive = Drive(straight(12)).until(12)
    seen = drive.seen_from(6)
    assert list(seen) == [0, 6, 12]
    np.testing.assert_allclose(seen[6], 0.0)
    assert seen[0][0] > 0.0 < seen[12][0]


@pytest.mark.parametrize("steps", [straight(60), rounds(60)], ids=["straight", "circle"])
def test_on_a_chain_it_is_the_marginal(steps):
    """Between knots, and from a knot to the newest keyframe. All but `LEAST_KNOWN`, which it counts in addition."""
    drive = Drive(steps, INFORMATION - LEAST_KNOWN).until(59)
    drive.edges = [Edge(e.kind, e.i, e.j, e.i_T_j, INFORMATION) for e in drive.edges]
    knots = drive.skeleton.knots.tolist()
    for i, j in ((0, knots[-1]), (knots[1], knots[4]), (knots[4], knots[1]), (knots[3], 59), (knots[-1], 59)):
        np.testing.assert_allclose(drive.relative(i, j), drive.exact(i, j), rtol=1e-3, atol=1e-9)
    for k, (sigma_m, sigma_rad) in drive.seen_from(59).items():
        covariance = drive.exact(59, k)
        assert sigma_m == pytest.approx(math.sqrt(covariance[0, 0] + covariance[1, 1]), rel=1e-3)
        assert sigma_rad == pytest.approx(math.sqrt(covariance[2, 2]), rel=1e-3)


def test_with_loops_it_bounds_the_marginal_from_above_and_closely():
    drive = tied_rounds(400)
    assert sum(e.kind == "loop" for e in drive.edges) > 10
    for i, j in ((0, 400), (12, 399), (30, 200), (6, 390), (120, 310)):
        ours, exact = drive.relative(i, j), drive.exact(i, j)
        more = np.linalg.eigvals(np.linalg.solve(exact, ours)).real
        assert more.min() > 0.99 and more.max() < 6.0, (i, j)
    for knot, sigmas in drive.seen_from(400).items():
        if knot != 400:
            covariance = drive.exact(400, knot)
            assert sigmas[0] > 0.99 * math.sqrt(covariance[0, 0] + covariance[1, 1])
            assert sigmas[1] > 0.99 * math.sqrt(covariance[2, 2])


def test_it_grows_with_the_spots_and_not_with_the_rounds():
    once, often = len(tied_rounds(80).skeleton), len(tied_rounds(1600).skeleton)
    assert once == pytest.approx(80 * 0.5 / 3.0, abs=2)
    assert often < 1.7 * once


def test_the_other_way_through_a_corridor_is_another_spot():
    there = straight(40)
    turn = np.tile([0.0, 0.0, math.pi / 4], (4, 1))
    steps = np.concatenate([there, turn, there, turn] * 3)
    drive = Drive(steps, 1e6 * INFORMATION).until(len(steps))
    spots = len(Drive(there).until(40).skeleton)
    assert len(drive.skeleton) == pytest.approx(2 * spots, abs=2)


def test_a_loop_makes_the_start_near_again():
    drive = Drive(rounds(80)).until(80)
    before = drive.seen_from(80)
    drive.loop(0, 80)
    after = drive.seen_from(80)
    assert after[0][0] < 0.2 * before[0][0]
    knots = sorted(before)
    half, last = knots[len(knots) // 2], knots[-1]
    assert after[half][0] == pytest.approx(before[half][0], rel=0.1)  # half way round it is as far either way
    assert after[last][0] == pytest.approx(before[last][0], rel=1e-6)


def test_a_loop_that_was_taken_out_ties_nothing_any_more():
    drive = Drive(rounds(80)).until(80)
    loose = drive.seen_from(80)
    false, true = drive.loop(0, 80), drive.loop(12, 48)
    drive.skeleton.without([false], drive.poses)
    assert drive.seen_from(80)[0][0] > 0.5 * loose[0][0]
    drive.skeleton.without([true], drive.poses)
    assert drive.seen_from(80)[0][0] == pytest.approx(loose[0][0])


def test_an_open_direction_is_a_wide_one_not_a_broken_one():
    """A corridor without wheels: nothing known along it. LEAST_KNOWN keeps that at 1 m a step."""
    drive = Drive(straight(16), np.diag([0.0, 1600.0, 2.5e5])).until(16)
    assert drive.seen_from(16)[0][0] == pytest.approx(4.0, rel=0.05)


def test_what_the_scans_leave_open_the_wheels_tell():
    """Along a corridor a match knows nothing, the wheels 4 cm a step: 16 steps are 16 cm, not 4 m."""
    skeleton, step = Skeleton(*KNOWN), np.array([0.5, 0.0, 0.0])
    poses = np.zeros((17, 3))
    poses[:, 0] = 0.5 * np.arange(17)
    for k in range(16):
        match = Edge("scan", k, k + 1, step, np.diag([0.0, 1e6, 1e8]))
        wheels = Edge("odometry", k, k + 1, step, np.diag([625.0, 625.0, 1e4]))
        skeleton.add_step([match, wheels], poses[: k + 2])
    assert math.sqrt(skeleton.relative_covariance(0, 16, poses)[0, 0]) == pytest.approx(0.16, rel=0.02)
