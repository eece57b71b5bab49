"""Wheels: circles in closed form, the paper's arctangent, counters that wrap, start again or jump."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mfslam import se2
from mfslam.config import WheelsConfig
from mfslam.kinematics import WheelIntegrator, body_twist, move
from mfslam.settings import load, preset_path
from mfslam.types import Findings, WheelAngles, WheelTicks

WHEELS = WheelsConfig(radius_left_m=0.1, radius_right_m=0.1, track_m=0.5, ticks_per_turn=1000.0)
M_PER_TICK = 2.0 * math.pi * 0.1 / 1000.0
STEP_NS = 100_000_000


def feed_ticks(values, wheels=WHEELS, step_ns=STEP_NS):
    """Poses (N, 3) and findings of tick pairs, one every tenth of a second."""
    findings = Findings()
    integrator = WheelIntegrator(wheels, findings)
    poses = [
        integrator.add_ticks(WheelTicks(k * step_ns, left, right)).odom_T_body
        for k, (left, right) in enumerate(values)
    ]
    return np.array(poses), findings


def test_twist_of_two_wheels():
    np.testing.assert_allclose(body_twist(10.0, 10.0, WHEELS), [1.0, 0.0, 0.0])
    np.testing.assert_allclose(body_twist(-5.0, 5.0, WHEELS), [0.0, 0.0, 2.0], atol=1e-15)
    np.testing.assert_allclose(body_twist(0.0, 5.0, WHEELS), [0.25, 0.0, 1.0])
    worn = WHEELS.model_copy(update={"radius_left_m": 0.08})
    np.testing.assert_allclose(body_twist(10.0, 10.0, worn), [0.9, 0.0, 0.4])


def test_the_papers_arctangent_is_the_yaw_rate_only_for_slow_turns():
    paper = WHEELS.model_copy(update={"yaw_rate_rule": "arctangent"})
    assert body_twist(-5.0, 5.0, paper)[2] == pytest.approx(math.atan(2.0))
    assert body_twist(-0.01, 0.01, paper)[2] == pytest.approx(0.004, rel=1e-5)
    turned, _ = feed_ticks([(0, 0), (-80, 80)], paper)
    rate = 160 * M_PER_TICK / 0.5 / 0.1
    assert turned[-1, 2] == pytest.approx(0.1 * math.atan(rate))


def test_a_full_circle_comes_home():
    """Left wheel on a radius of 0.75 m, right on 1.25 m: the body's is 1 m. Steps of 18 deg are exact."""
    twist = body_twist(7.5, 12.5, WHEELS)
    pose = np.zeros(3)
    for _ in range(20):
        pose = move(pose, twist, math.pi / 10.0)
    np.testing.assert_allclose(move(np.zeros(3), twist, math.pi / 2.0), [1.0, 1.0, math.pi / 2], atol=1e-12)
    np.testing.assert_allclose(pose, 0.0, atol=1e-12)


def test_driving_back_undoes_driving():
    """The sign of v counts, which eqs. 12 and 40 lose."""
    out = [(0, 0), (300, 500), (900, 600), (1000, 1300)]
    poses, _ = feed_ticks(out + out[-2::-1])
    np.testing.assert_allclose(poses[-1], 0.0, atol=1e-12)
    np.testing.assert_allclose(poses[2], poses[4], atol=1e-12)


@settings(max_examples=50, deadline=None, derandomize=True)
@given(
    st.lists(st.tuples(st.integers(-400, 400), st.integers(-400, 400)), min_size=2, max_size=30),
    st.sampled_from([2**16, 2**32]),
    st.booleans(),
    st.integers(0, 2**32 - 1),
)
def test_counters_that_wrap_are_followed(steps, span, signed, start):
    """Any motion, any start: as if the counters had no end."""
    plain = np.concatenate([[[0, 0]], np.cumsum(steps, axis=0)]) + start % span
    half = span // 2 if signed else 0
    wrapped = (plain + half) % span - half
    # a counter is known by its range once it was seen there: a first step of unlucky size is no evidence
    expected, _ = feed_ticks([(int(a), int(b)) for a, b in plain - plain[0]])
    got, findings = feed_ticks([(int(a), int(b)) for a, b in wrapped])
    np.testing.assert_allclose(got, expected, atol=1e-9)
    wraps = int(np.count_nonzero(np.any(np.abs(np.diff(wrapped, axis=0)) > span // 2, axis=1)))
    assert findings.count("wheel-counter-wrapped") == wraps
    assert "wheel-counter-jump" not in findings


def test_angles_within_one_turn_are_followed():
    wheels = WheelIntegrator(WHEELS)
    for k in range(101):
        angle = 0.8 * k  # 0.8 rad a step: 8 turns in all
        pose = wheels.add_angles(WheelAngles(k * STEP_NS, float(se2.wrap(angle)), float(se2.wrap(angle))))
    np.testing.assert_allclose(pose.odom_T_body, [8.0, 0.0, 0.0], atol=1e-9)
    assert wheels.findings.count("wheel-counter-wrapped") > 5


def test_angles_that_grow_without_end_are_taken_as_they_are():
    wheels = WheelIntegrator(WHEELS)
    for k in range(50):
        pose = wheels.add_angles(WheelAngles(k * STEP_NS, 2.5 * k, 2.5 * k))
    np.testing.assert_allclose(pose.odom_T_body, [2.5 * 49 * 0.1, 0.0, 0.0], atol=1e-9)
    assert len(wheels.findings) == 0


def test_counters_that_start_again_leave_the_pose_where_it_is():
    """The encoder board restarts after 25 m: the pose goes on from where it was."""
    values = [(100_000 + 100 * k, 100_000 + 100 * k) for k in range(4)] + [(0, 0), (100, 100), (200, 300)]
    poses, findings = feed_ticks(values)
    np.testing.assert_allclose(poses[4], poses[3])
    np.testing.assert_allclose(poses[5, 0] - poses[3, 0], 100 * M_PER_TICK)
    assert findings.count("wheel-counter-jump") == 1
    assert "left out" in findings.lines()[0]
    assert f"{4 * STEP_NS} ns" in findings.lines()[0]


def test_a_garbled_counter_costs_two_steps_and_no_more():
    values = [(100 * k, 100 * k) for k in range(10)]
    values[5] = (2_000_000_000, 500)
    poses, findings = feed_ticks(values)
    assert findings.count("wheel-counter-jump") == 2
    np.testing.assert_allclose(poses[-1], [700 * M_PER_TICK, 0.0, 0.0], atol=1e-12)


def test_a_jump_that_a_wheel_could_make_is_integrated_and_taken_back():
    """0.3 m in a tenth of a second and back: the caller decides what it believes, the pose comes home."""
    poses, findings = feed_ticks([(0, 0), (100, 100), (700, 200), (300, 300)])
    straight, _ = feed_ticks([(0, 0), (100, 100), (200, 200), (300, 300)])
    assert len(findings) == 0
    assert abs(poses[2, 2]) > 0.5
    assert poses[3, 2] == pytest.approx(straight[3, 2], abs=1e-12)


def test_bursts_and_stamps_that_go_backwards_lose_nothing():
    wheels = WheelIntegrator(WHEELS)
    for k, stamp_ns in enumerate([0, 0, 0, 5_000_000, 1_000_000, 400_000_000]):
        odometry = wheels.add_ticks(WheelTicks(stamp_ns, 50 * k, 50 * k))
        assert odometry.stamp_ns == stamp_ns
    np.testing.assert_allclose(odometry.odom_T_body, [250 * M_PER_TICK, 0.0, 0.0], atol=1e-12)
    assert len(wheels.findings) == 0


def test_a_long_gap_may_hold_a_long_way():
    poses, findings = feed_ticks([(0, 0), (20_000, 20_000)], step_ns=20_000_000_000)
    np.testing.assert_allclose(poses[-1], [20_000 * M_PER_TICK, 0.0, 0.0])
    assert len(findings) == 0


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_angles_that_are_no_numbers_are_counted(bad):
    wheels = WheelIntegrator(WHEELS)
    wheels.add_angles(WheelAngles(0, 1.0, 1.0))
    kept = wheels.add_angles(WheelAngles(STEP_NS, bad, 1.1))
    np.testing.assert_array_equal(kept.odom_T_body, np.zeros(3))
    after = wheels.add_angles(WheelAngles(2 * STEP_NS, 1.2, 1.2))
    np.testing.assert_allclose(after.odom_T_body, [0.02, 0.0, 0.0], atol=1e-12)
    assert wheels.findings.count("wheel-angle-invalid") == 1


@pytest.mark.parametrize("name", ["exp2", "exp3"])
def test_recorded_ticks_give_the_way_that_was_driven(shared_data, name):
    """Real encoders, jumps of single samples included: no step is lost, arcs are as long as their ticks say."""
    from drivers.logs import open_log

    settings = load([preset_path("urg-04lx"), preset_path("urg-text-robot")])
    wheels = WheelIntegrator(settings.wheels)
    with open_log(shared_data / "urg04lx" / f"{name}.dat.gz", settings) as log:
        ticks = [message for message in log if isinstance(message, WheelTicks)]
    track = np.array([wheels.add_ticks(message).odom_T_body for message in ticks])
    m_per_tick = 2.0 * math.pi * settings.wheels.radius_left_m / settings.wheels.ticks_per_turn
    left, right = np.diff([[t.left, t.right] for t in ticks], axis=0).T * m_per_tick
    arcs_m = np.abs(0.5 * (left + right))
    chords_m = np.hypot(*np.diff(track[:, :2], axis=0).T)
    assert len(wheels.findings) == 0
    assert np.all(chords_m <= arcs_m + 1e-12)
    assert arcs_m.sum() > 20.0
    assert chords_m.sum() == pytest.approx(arcs_m.sum(), rel=0.01)
    heading = np.sum(right - left) / settings.wheels.track_m
    assert track[-1, 2] == pytest.approx(float(se2.wrap(heading)), abs=1e-9)
