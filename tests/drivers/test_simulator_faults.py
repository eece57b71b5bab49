"""What goes wrong on the way into the log, and tracks that slip: against what it would be without."""

import dataclasses

import numpy as np
import pytest

from drivers.simulator import Faults, Motion, RobotModel, beam_truth, laser_model, parse_world, simulate
from drivers.simulator.sensors import stamped_at_first
from drivers.simulator.simulate import START_NS
from mfslam import se2
from mfslam.config import WheelsConfig
from mfslam.types import Imu, Odometry, Scan, WheelAngles, WheelTicks

ROOM = parse_world("wall -9 -9 9 -9 9 9 -9 9 -9 -9\n", "room")
ARC = Motion.from_twists(np.full(100, 0.1), np.tile([0.8, 0.0, 0.4], (100, 1)))
FINE = WheelsConfig(radius_left_m=0.08, radius_right_m=0.08, track_m=0.35, ticks_per_turn=1e7)


def run(faults=None, world=ROOM, laser=None, motion=ARC, seed=0, **robot):
    model = RobotModel(wheels=FINE, **robot)
    laser = laser_model("generic") if laser is None else laser
    return simulate(world, model, laser, motion=motion, faults=faults, seed=seed)


def of(kind, simulation):
    return [m for m in simulation.messages if isinstance(m, kind)]


def times(messages):
    return np.array([(m.stamp_ns - START_NS) * 1e-9 for m in messages])


def same_ranges(a, b):
    return all(np.array_equal(x.ranges_m, y.ranges_m) for x, y in zip(a.scans, b.scans, strict=True))


def test_scans_of_a_burst_come_together_with_the_last_one_s_stamp():
    whole, bursts = run(), run(Faults(burst_scans=4))
    expected = times(whole.scans)
    last = np.minimum(np.arange(len(expected)) // 4 * 4 + 3, len(expected) - 1)
    np.testing.assert_allclose(
        times(bursts.scans), expected[last] + np.arange(len(expected)) % 4 * 1e-3, atol=1e-9
    )
    newest_ns = START_NS
    for message in bursts.messages:  # nothing comes before the wheels have been read at its stamp
        assert message.stamp_ns <= newest_ns + 20_000_000
        newest_ns = message.stamp_ns if isinstance(message, Odometry) else newest_ns
    assert same_ranges(whole, bursts)
    np.testing.assert_array_equal(whole.truth_world_T_body, bursts.truth_world_T_body)


def test_stamp_jitter_has_its_sigma_and_keeps_the_order_of_scans():
    whole, jittered = run(), run(Faults(stamp_jitter_s=0.02))
    error = times(jittered.scans) - times(whole.scans)
    assert np.std(error) == pytest.approx(0.02, rel=0.25) and abs(np.mean(error)) < 0.01
    assert same_ranges(whole, jittered)
    assert jittered.truth_stamps_ns.tolist() == [s.stamp_ns for s in jittered.scans]
    np.testing.assert_array_equal(whole.truth_world_T_body, jittered.truth_world_T_body)


def test_a_restart_is_silent_then_counts_from_zero_on_a_clock_that_has_jumped():
    faults = Faults(restarts=((4.0, 1.0, 100.0),))
    for kind, robot in (
        (Odometry, {}),
        (WheelTicks, {"odometry": "ticks"}),
        (WheelAngles, {"odometry": "angles"}),
    ):
        whole, restarted = run(gyro_rate_hz=50.0, **robot), run(faults, gyro_rate_hz=50.0, **robot)
        stamps = times(of(kind, restarted))
        before, after = stamps[stamps < 50.0], stamps[stamps >= 50.0]
        assert before[-1] < 4.0 and after[0] == pytest.approx(105.0)
        np.testing.assert_allclose(after - 100.0, [t for t in times(of(kind, whole)) if t >= 5.0], atol=1e-9)
        first = of(kind, restarted)[len(before)]
        values = dataclasses.astuple(first)[1:] if kind is not Odometry else first.odom_T_body
        np.testing.assert_allclose(values, 0.0, atol=1e-12)
        assert not np.any((times(of(Imu, restarted)) >= 4.0) & (times(of(Imu, restarted)) < 105.0))


def test_after_a_restart_odometry_and_truth_tell_the_same_motion():
    restarted = run(Faults(restarts=((4.0, 1.0, -2.0),)))
    assert len(restarted.scans) < len(run().scans)
    late = np.flatnonzero(restarted.instants_s >= 5.0)
    assert late.size > 30
    np.testing.assert_allclose(
        restarted.truth_stamps_ns[late], START_NS + (restarted.instants_s[late] - 2.0) * 1e9, atol=1.0
    )
    scans = restarted.scans
    odom = np.stack([scans[i].odom_T_body for i in late])
    truth = restarted.truth_world_T_body[late]
    np.testing.assert_allclose(se2.between(odom[0], odom), se2.between(truth[0], truth), atol=1e-4)
    assert np.hypot(*odom[0][:2]) < 0.1, "it begins near zero"


def test_mixed_pixels_lie_between_the_surfaces_beside_an_edge():
    world = parse_world("wall -6 -6 6 -6 6 6 -6 6 -6 -6\nwall 3 -1 3 1\n")
    clean = dataclasses.replace(laser_model("generic"), noise=False, range_step_m=0.0)
    mixed = dataclasses.replace(clean, mixed_share=0.5)
    still = Motion.from_twists([30.0], [[0.0, 0.0, 0.0]])
    true = np.stack([s.ranges_m for s in run(world=world, laser=clean, motion=still).scans])
    spoilt = np.stack([s.ranges_m for s in run(world=world, laser=mixed, motion=still).scans])
    changed = spoilt != true
    edges = np.flatnonzero(np.abs(np.diff(true[0])) > 1.0)
    assert len(edges) == 2
    beside = np.union1d(edges, edges + 1)
    assert np.array_equal(np.flatnonzero(changed.any(axis=0)), beside)
    assert np.sum(changed) / (2 * len(true)) == pytest.approx(0.5, abs=0.1)
    near, far = true[0][beside].min(), true[0][beside].max()
    assert np.all((spoilt[:, beside] >= near) & (spoilt[:, beside] <= far))


def test_tracks_reckon_too_much_turning_by_their_factor_and_nothing_of_it_is_random():
    turned = [run(turning_track_factor=1.5, seed=seed).scans[-1] for seed in (1, 2)]
    np.testing.assert_array_equal(turned[0].odom_T_body, turned[1].odom_T_body)
    expected = float(se2.wrap(1.5 * 0.4 * (turned[0].stamp_ns - START_NS) * 1e-9))
    assert turned[0].odom_T_body[2] == pytest.approx(expected, abs=1e-5)


def test_slip_of_tracks_grows_with_the_turning_and_is_none_on_a_straight_line():
    straight = Motion.from_twists([10.0], [[0.8, 0.0, 0.0]])
    spoilt = {"turning_slip_m_per_sqrt_rad": 0.02, "odometry": "angles", "encoder_rate_hz": 5.0}
    assert of(WheelAngles, run(motion=straight, **spoilt))[-1].left_rad == pytest.approx(100.0, abs=1e-9)
    ends = [of(WheelAngles, run(seed=seed, **spoilt))[-1] for seed in range(64)]
    way = np.array([[w.left_rad, w.right_rad] for w in ends]) * 0.08
    true = 10.0 * (0.8 + 0.4 * 0.175 * np.array([-1.0, 1.0]))
    np.testing.assert_allclose(np.std(way - true, axis=0), 0.02 * np.sqrt(4.0), rtol=0.3)


def test_encoders_are_read_from_their_phase_on_and_stamped_with_jitter():
    exact = run(odometry="angles", encoder_rate_hz=20.0, encoder_phase_s=0.013)
    np.testing.assert_allclose(times(of(WheelAngles, exact)), 0.013 + 0.05 * np.arange(200), atol=1e-9)
    jittered = run(odometry="angles", encoder_rate_hz=20.0, encoder_phase_s=0.013, encoder_jitter_s=0.004)
    error = times(of(WheelAngles, jittered)) - times(of(WheelAngles, exact))
    assert np.std(error) == pytest.approx(0.004, rel=0.2)
    assert [m.left_rad for m in of(WheelAngles, jittered)] == [m.left_rad for m in of(WheelAngles, exact)]


def test_new_faults_leave_the_noise_of_everything_else_as_it_was():
    plain = run(slip_m_per_sqrt_m=0.01)
    spoilt = run(Faults(stamp_jitter_s=1e-9, burst_scans=2), slip_m_per_sqrt_m=0.01, encoder_jitter_s=0.001)
    assert same_ranges(plain, spoilt)


def test_a_ros_laser_bears_the_stamp_of_its_first_beam():
    laser = laser_model("sick-lms291")
    moved = stamped_at_first(laser)
    assert laser.laser.offsets_s.min() < 0.0 and moved.laser.offsets_s.min() == 0.0
    np.testing.assert_allclose(np.diff(moved.laser.offsets_s), np.diff(laser.laser.offsets_s), atol=1e-15)


def test_beam_truth_names_what_it_hit():
    world = parse_world(
        "wall -5 -5 -5 5\nglass 5 -1 5 1\npillar 0 4 0.5\ndoor 2 -4 4 -4 90 8\nperson 0.3 0.5 -1 -3 -2 -3\n"
    )
    still = Motion.from_twists([2.0], [[0.0, 0.0, 0.0]])
    laser = laser_model("generic")
    truth = beam_truth(world, still, laser, np.array([0.0]))
    bearing = np.degrees(laser.laser.angles_rad)
    seen = {round(b): int(h) for b, h in zip(bearing, truth.hits[0], strict=True)}
    assert (seen[0], seen[90], seen[-180], seen[45]) == (2, 3, 1, 0)
    assert seen[-50] == 4  # the door's leaf, still closed, from (2, -4) to (4, -4)
    assert seen[round(np.degrees(np.arctan2(-3.0, -1.0)))] == 5
    np.testing.assert_array_equal(truth.world_T_laser, np.zeros((1, 360, 3)))


@pytest.mark.parametrize("faults", [Faults(stamp_jitter_s=0.05), Faults(burst_scans=3)])
def test_readings_made_for_a_scan_come_just_before_it(faults):
    """As a URG text log needs it: one line has a scan and its ticks."""
    messages = run(faults, odometry="ticks", encoder_rate_hz=None).messages
    assert len(messages) % 2 == 0
    for ticks, scan in zip(messages[::2], messages[1::2], strict=True):
        assert isinstance(ticks, WheelTicks) and isinstance(scan, Scan) and ticks.stamp_ns == scan.stamp_ns
