"""The engine on simulated logs with exact truth: each fault alone, and what the solution says of itself."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from drivers.simulator import (
    Faults,
    Motion,
    RobotModel,
    drive,
    laser_model,
    parse_world,
    simulate,
)
from mfslam import se2
from mfslam.config import Config
from mfslam.metrics import ate
from mfslam.observability import open_stretches
from mfslam.settings import load, preset_path
from mfslam.slam import Slam, edges_at_stamps
from mfslam.types import Edge, Findings, MfslamError, Odometry, Scan

# 12 m by 8 m with a wall across the middle: a ring of about 24 m to drive around it, nothing repeats
RING = parse_world(
    """
    wall 0 0 12 0 12 8 0 8 0 0
    box 6 4 6 2.2
    box 1.0 0.4 1.4 0.6
    box 11.5 2.4 0.8 1.2 15
    box 7.2 7.6 1.6 0.6
    pillar 0.4 5.5 0.25
    box 4.1 0.3 0.5 0.5 30
    pillar 9.3 0.35 0.2
    box 3.0 7.7 0.9 0.5
    start 2 1.4 0
    path 2 1.4 1.5
    path 10.5 1.4
    path 10.5 6.6
    path 1.5 6.6
    path 1.5 1.4
    path 10.5 1.4
    path 10.5 4.0
    """,
    "ring",
)
ROBOT = RobotModel(radius_error_left=-0.02, radius_error_right=-0.015, slip_m_per_sqrt_m=0.003)
FAST = laser_model("fast", (0.1, 0.0, 0.0))


def log_of(robot=ROBOT, laser=FAST, faults=None, world=RING, in_scans=False):
    simulation = simulate(world, robot, laser, seed=5, faults=faults)
    if not in_scans:
        simulation.messages[:] = [
            dataclasses.replace(m, odom_T_body=None) if isinstance(m, Scan) else m
            for m in simulation.messages
        ]
    return simulation


def run(simulation, config=None):
    slam = Slam(config or Config())
    for message in simulation.messages:
        slam.feed(message)
    return slam, slam.finish()


def error_of(simulation, solution):
    error = ate(simulation.truth_world_T_body, solution.world_T_body)
    return error.translation_m.rmse, error.rotation_deg.rmse


@pytest.fixture(scope="module")
def plain():
    simulation = log_of()
    return simulation, *run(simulation)


# --- the whole -----------------------------------------------------------------------------------------


def test_a_drive_comes_out_right_to_the_centimetre(plain):
    simulation, _, solution = plain
    shift_m, turn_deg = error_of(simulation, solution)
    assert shift_m < 0.015 and turn_deg < 0.4
    wheels = [m.odom_T_body for m in simulation.messages if isinstance(m, Odometry)]
    drift = np.hypot(
        *(se2.between(wheels[0], wheels[-1]) - se2.between(*simulation.truth_world_T_body[[0, -1]]))[:2]
    )
    assert drift > 20 * shift_m


def test_every_scan_has_a_pose_in_log_order(plain):
    simulation, _, solution = plain
    np.testing.assert_array_equal(solution.stamps_ns, simulation.truth_stamps_ns)
    assert solution.world_T_body.shape == (len(simulation.scans), 3)
    assert solution.keyframes[0] == 0 and np.all(np.diff(solution.keyframes) > 0)
    # the first keyframe stays at the origin, until smoothing moves every scan within its noise
    np.testing.assert_allclose(solution.world_T_body[0], 0.0, atol=2e-3)


def test_loops_of_the_second_round_are_found_and_true(plain):
    simulation, _, solution = plain
    truth = simulation.truth_world_T_body[solution.keyframes]
    loops = [e for e in solution.edges if e.kind == "loop"]
    assert loops
    for edge in loops:
        off = se2.between(se2.between(truth[edge.i], truth[edge.j]), edge.i_T_j)
        assert math.hypot(off[0], off[1]) < 0.1 and abs(off[2]) < 0.03


def test_edges_speak_of_the_solution(plain):
    """At the end every scan edge stands within some sigmas of the poses."""
    _, _, solution = plain
    poses = solution.world_T_body[solution.keyframes]
    chi2 = []
    for edge in solution.edges:
        if edge.kind == "scan":
            e = se2.log(se2.between(edge.i_T_j, se2.between(poses[edge.i], poses[edge.j])))
            chi2.append(e @ edge.information @ e)
    assert np.median(chi2) < 3.0


def test_the_same_log_gives_the_same_bits(plain):
    _, _, first = plain
    _, again = run(log_of())
    assert again.world_T_body.tobytes() == first.world_T_body.tobytes()
    assert [e.i_T_j.tobytes() for e in again.edges] == [e.i_T_j.tobytes() for e in first.edges]


def test_the_solution_so_far_can_be_had_at_any_time():
    simulation = log_of()
    slam = Slam(Config())
    for message in simulation.messages[: len(simulation.messages) // 2]:
        slam.feed(message)
    solution = slam.solution_so_far()
    half = len(solution.stamps_ns)
    assert half == len(slam.scans) > 50
    assert ate(simulation.truth_world_T_body[:half], solution.world_T_body).translation_m.rmse < 0.05


def test_a_log_without_scans_is_named():
    slam = Slam(Config())
    slam.feed(Odometry(0, np.zeros(3)))
    with pytest.raises(MfslamError, match="no scans"):
        slam.finish()


def test_one_scan_is_a_map():
    simulation = log_of()
    slam = Slam(Config())
    slam.feed(simulation.scans[0])
    solution = slam.finish()
    np.testing.assert_allclose(solution.world_T_body, np.zeros((1, 3)), atol=1e-12)
    assert solution.edges == []


# --- one fault each ------------------------------------------------------------------------------------

NO_WHEELS = dataclasses.replace(ROBOT, odometry="none")
JUMPS = Faults(odometry_jumps=((6.0, 0.9, 0.0, 0.0), (11.0, 0.0, 0.0, 1.5), (16.0, -0.6, 0.6, -1.0)))
FAULTS = {
    "no odometry": {"robot": NO_WHEELS},
    "10 % too long": {"robot": dataclasses.replace(ROBOT, radius_error_left=-0.1, radius_error_right=-0.1)},
    "yaw drift": {"robot": dataclasses.replace(ROBOT, track_error=0.05, radius_error_right=0.0)},
    "odometry jumps": {"faults": JUMPS},
    "odometry jumps, poses in scans": {"faults": JUMPS, "in_scans": True},
    "odometry gaps": {"faults": Faults(odometry_gaps_s=((3.0, 5.0), (9.0, 12.0)))},
    "scans missing": {"faults": Faults(scan_gaps_s=((4.0, 5.0), (10.0, 12.0)))},
    "a robot at 3 m/s": {
        "world": dataclasses.replace(RING, speeds_m_s=np.full_like(RING.speeds_m_s, 3.0)),
        "robot": dataclasses.replace(ROBOT, acceleration_m_s2=4.0, lateral_acceleration_m_s2=4.0),
    },
}


@pytest.mark.parametrize("fault", FAULTS)
def test_one_fault_costs_centimetres_at_most(fault):
    simulation = log_of(**FAULTS[fault])
    _, solution = run(simulation)
    shift_m, turn_deg = error_of(simulation, solution)
    assert shift_m < 0.04 and turn_deg < 1.0, (shift_m, turn_deg)


def test_jumps_are_reported():
    slam, _ = run(log_of(faults=JUMPS))
    assert len(slam.odometry_jumps) >= 3


def test_a_4_m_laser_will_do():
    simulation = log_of(laser=laser_model("urg-04lx", (0.1, 0.0, 0.0)))
    _, solution = run(simulation, load([preset_path("urg-04lx")]))
    shift_m, turn_deg = error_of(simulation, solution)
    assert shift_m < 0.06 and turn_deg < 1.0


def test_wheels_that_have_not_told_yet_are_not_taken_to_stand_still():
    """Odometry at 4 Hz under a laser at 10 Hz: a scan is placed before the next reading has come."""
    simulation = log_of()
    slow = [m for m in simulation.messages if not isinstance(m, Odometry) or m.stamp_ns % 250_000_000 == 0]
    assert 20 < sum(isinstance(m, Odometry) for m in slow) < 200
    simulation.messages[:] = slow
    _, solution = run(simulation)
    assert error_of(simulation, solution)[0] < 0.02


def test_wheels_that_are_not_connected_are_found_out():
    """Odometry that stays at zero while the scans tell of driving."""
    simulation = log_of()
    simulation.messages[:] = [
        dataclasses.replace(m, odom_T_body=np.zeros(3)) if isinstance(m, Odometry) else m
        for m in simulation.messages
    ]
    _, solution = run(simulation)
    shift_m, turn_deg = error_of(simulation, solution)
    assert shift_m < 0.04 and turn_deg < 1.0


def test_a_robot_at_rest_in_a_bare_corridor_does_not_slide():
    """Wheels that have not turned yet say that it stands; noise along the corridor says nothing."""
    world = parse_world("wall -50 -1 50 -1\nwall -50 1 50 1\nwall -50 -1 -50 1", "bare")
    motion = Motion.from_twists([4.0], [[0.0, 0.0, 0.0]])
    simulation = simulate(world, ROBOT, FAST, seed=5, motion=motion)
    _, solution = run(simulation)
    assert np.hypot(*solution.world_T_body[:, :2].T).max() < 0.05


# --- time ----------------------------------------------------------------------------------------------


def delayed_log(delay_s):
    told = dataclasses.replace(FAST.laser, offsets_s=FAST.laser.offsets_s - delay_s)
    return log_of(laser=dataclasses.replace(FAST, stamp_delay_s=delay_s, reported=told))


def test_a_known_transport_delay_is_taken_out():
    """Stamps 0.2 s late, at up to 1.5 m/s: uncorrected the poses would be up to 0.3 m off."""
    simulation = delayed_log(0.2)
    _, solution = run(simulation)
    shift_m, turn_deg = error_of(simulation, solution)
    # the turn between sensing and stamp is told by the twist through the scan: the robot may brake since
    assert shift_m < 0.02 and turn_deg < 1.2


def test_edges_at_the_stamps_have_the_residuals_of_those_at_the_reference():
    """The same chi2, to first order, whichever instant poses and edges speak of."""
    rng = np.random.default_rng(7)
    reference = se2.compose(rng.normal(0.0, 2.0, (6, 3)), np.zeros(3))
    motion = se2.exp(rng.normal(0.0, [0.3, 0.05, 0.3], (6, 3)))
    stamps = se2.compose(reference, motion)
    root = rng.normal(size=(3, 3)) * [10.0, 10.0, 30.0]
    edges = []
    for i, j in ((0, 1), (1, 2), (4, 2), (5, 0)):
        error = se2.exp(rng.normal(0.0, 1e-4, 3))
        edges.append(
            Edge("scan", i, j, se2.compose(se2.between(reference[i], reference[j]), error), root @ root.T)
        )
    for before, after in zip(edges, edges_at_stamps(edges, motion), strict=True):
        chi2 = []
        for edge, poses in ((before, reference), (after, stamps)):
            e = se2.log(se2.between(edge.i_T_j, se2.between(poses[edge.i], poses[edge.j])))
            chi2.append(float(e @ edge.information @ e))
        assert chi2[1] == pytest.approx(chi2[0], rel=1e-3)
        assert after.weight == before.weight and (after.i, after.j, after.kind) == (
            before.i,
            before.j,
            "scan",
        )


def test_heading_edges_stay_as_they_are():
    edge = Edge("heading", 0, 1, np.array([0.0, 0.0, 0.3]), np.diag([0.0, 0.0, 9.0]))
    assert edges_at_stamps([edge], np.ones((2, 3))) == [edge]


def test_a_delayed_log_ends_with_edges_between_its_stamps():
    _, solution = run(delayed_log(0.2))
    poses = solution.world_T_body[solution.keyframes]
    off = np.array(
        [
            se2.between(e.i_T_j, se2.between(poses[e.i], poses[e.j]))
            for e in solution.edges
            if e.kind == "scan" and e.j == e.i + 1
        ]
    )
    assert np.median(np.hypot(off[:, 0], off[:, 1])) < 0.005


def test_stamps_that_go_backwards_are_taken_in_log_order(plain):
    """Bursts as hosts write them: every seventh scan is stamped 0.15 s early."""
    simulation, _, _ = plain
    late = [
        dataclasses.replace(m, stamp_ns=m.stamp_ns - 150_000_000 * (n % 7 == 3)) if isinstance(m, Scan) else m
        for n, m in enumerate(log_of(in_scans=True).messages)
    ]
    slam = Slam(Config())
    for message in late:
        slam.feed(message)
    solution = slam.finish()
    assert np.any(np.diff(solution.stamps_ns) < 0)
    assert ate(simulation.truth_world_T_body, solution.world_T_body).translation_m.rmse < 0.1


# --- what the solution says of itself ------------------------------------------------------------------


def test_a_bare_corridor_is_told_as_weak_and_left_to_the_wheels():
    world = parse_world("wall -50 -1 50 -1\nwall -50 1 50 1\npath 0 0 1\npath 12 0", "bare")
    exact = RobotModel()
    simulation = simulate(world, exact, FAST, seed=5, motion=drive(world, exact, rest_s=3.0))
    _, solution = run(simulation)
    stretches = open_stretches(solution.world_T_body[solution.keyframes], solution.keyframes, solution.edges)
    assert sum(s.travelled_m for s in stretches) == pytest.approx(12.0, abs=2.5)
    longest = max(stretches, key=lambda s: s.travelled_m)
    assert longest.travelled_m > 6.0 and abs(longest.direction_rad) < 0.1  # along the corridor
    sigmas = np.sqrt(solution.covariances[-1].diagonal())
    assert sigmas[0] > sigmas[1]  # and so is the uncertainty
    assert error_of(simulation, solution)[0] < 0.15  # 1 % of the way


def test_the_plain_ring_has_no_weak_directions(plain):
    _, _, solution = plain
    stretches = open_stretches(solution.world_T_body[solution.keyframes], solution.keyframes, solution.edges)
    assert sum(s.travelled_m for s in stretches) < 1.0


def test_a_robot_at_rest_stays_where_it_is():
    motion = Motion.from_twists([4.0], [[0.0, 0.0, 0.0]], (2.0, 1.4, 0.3))
    simulation = simulate(RING, ROBOT, FAST, seed=5, motion=motion)
    slam, solution = run(simulation)
    assert len(solution.keyframes) == 1
    assert np.abs(solution.world_T_body[:, :2]).max() < 0.02
    assert isinstance(slam.findings, Findings) and len(slam.findings) == 0
