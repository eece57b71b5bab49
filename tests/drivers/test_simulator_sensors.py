"""What the simulated log says: wheels, laser, gyro, clocks and faults, against the truth."""

import dataclasses

import numpy as np
import pytest

from drivers.simulator import Faults, Motion, RobotModel, demo_simulation, laser_model, parse_world, simulate
from drivers.simulator.simulate import START_NS, cast_scans
from mfslam import se2
from mfslam.config import WheelsConfig
from mfslam.types import Imu, MfslamError, Odometry, Scan, WheelAngles, WheelTicks

ROOM = parse_world("wall -9 -9 9 -9 9 9 -9 9 -9 -9\n", "room")
ARC = Motion.from_twists(np.full(100, 0.1), np.tile([0.8, 0.0, 0.4], (100, 1)))
LINE = Motion.from_twists([10.0], [[0.8, 0.0, 0.0]], [-4.0, 0.0, 0.0])
FINE = WheelsConfig(radius_left_m=0.08, radius_right_m=0.08, track_m=0.35, ticks_per_turn=1e7)


def run(robot=None, laser=None, motion=ARC, **more):
    return simulate(
        ROOM,
        robot if robot is not None else RobotModel(wheels=FINE),
        laser if laser is not None else laser_model("generic"),
        motion=motion,
        **more,
    )


def of(kind, simulation):
    return [m for m in simulation.messages if isinstance(m, kind)]


def test_perfect_wheels_dead_reckon_to_the_truth():
    simulation = run()
    for message in of(Odometry, simulation):
        truth = simulation.truth_at(np.array(message.stamp_ns))
        np.testing.assert_allclose(message.odom_T_body, truth, atol=1e-5)
    for scan, truth in zip(simulation.scans, simulation.truth_world_T_body, strict=True):
        np.testing.assert_allclose(scan.odom_T_body, truth, atol=1e-5)


def test_small_wheels_count_too_far_and_unequal_ones_turn():
    """True radii 3 % under nominal: 1/0.97 of the way. A right wheel smaller still: a turn to the left."""
    scaled = dataclasses.replace(RobotModel(wheels=FINE), radius_error_left=-0.03, radius_error_right=-0.03)
    assert run(scaled, motion=LINE).scans[-1].odom_T_body[0] == pytest.approx(
        0.8 * run(scaled, motion=LINE).instants_s[-1] / 0.97, abs=1e-5
    )
    unequal = dataclasses.replace(RobotModel(wheels=FINE), radius_error_right=-0.01)
    simulation = run(unequal, motion=LINE)
    way = 0.8 * simulation.instants_s[-1]
    turn = (way / 0.99 - way) / FINE.track_m
    assert simulation.scans[-1].odom_T_body[2] == pytest.approx(turn, abs=1e-5)


def test_a_wide_track_turns_too_little():
    wide = dataclasses.replace(RobotModel(wheels=FINE), track_error=0.1)
    simulation = run(wide)
    turned = se2.wrap(0.4 * simulation.instants_s[-1] * 1.1)
    assert simulation.scans[-1].odom_T_body[2] == pytest.approx(float(turned), abs=1e-5)


def test_ticks_are_whole_and_within_half_a_tick():
    coarse = WheelsConfig(radius_left_m=0.08, radius_right_m=0.08, track_m=0.35, ticks_per_turn=256)
    simulation = run(RobotModel(wheels=coarse, odometry="ticks"))
    ticks = of(WheelTicks, simulation)
    assert len(ticks) == 501 and all(isinstance(t.left, int) for t in ticks)
    times = np.array([(t.stamp_ns - START_NS) * 1e-9 for t in ticks])
    per_m = 256 / (2.0 * np.pi * 0.08)
    left = times * (0.8 - 0.4 * 0.175) * per_m
    right = times * (0.8 + 0.4 * 0.175) * per_m
    assert np.max(np.abs(np.array([t.left for t in ticks]) - left)) <= 0.5 + 1e-6
    assert np.max(np.abs(np.array([t.right for t in ticks]) - right)) <= 0.5 + 1e-6


def test_angles_and_readings_at_scan_stamps():
    simulation = run(RobotModel(wheels=FINE, odometry="angles", encoder_rate_hz=None))
    angles = of(WheelAngles, simulation)
    assert [a.stamp_ns for a in angles] == [s.stamp_ns for s in simulation.scans]
    assert angles[50].left_rad == pytest.approx(5.0 * (0.8 - 0.4 * 0.175) / 0.08, abs=1e-9)


def test_slip_grows_with_the_root_of_the_way():
    """64 runs of 8 m: the sigma of the way of each wheel is slip * sqrt(8), within its own scatter."""
    slipping = RobotModel(wheels=FINE, slip_m_per_sqrt_m=0.02, odometry="angles", encoder_rate_hz=5.0)
    ends = []
    for seed in range(64):
        last = of(WheelAngles, run(slipping, motion=LINE, seed=seed))[-1]
        ends.append([last.left_rad * 0.08, last.right_rad * 0.08])
    sigma = np.std(np.array(ends) - 8.0, axis=0)
    np.testing.assert_allclose(sigma, 0.02 * np.sqrt(8.0), rtol=0.3)


def test_range_noise_has_the_laser_s_sigma_and_no_bias():
    laser = dataclasses.replace(laser_model("generic"), range_step_m=0.0)
    simulation = run(laser=laser)
    exact = cast_scans(ROOM, ARC, laser, simulation.instants_s)
    error = np.stack([s.ranges_m for s in simulation.scans]) - exact
    assert np.std(error) == pytest.approx(laser.laser.range_sigma_m, rel=0.02)
    assert abs(np.mean(error)) < 4.0 * laser.laser.range_sigma_m / np.sqrt(error.size)


def test_resolution_limits_and_error_codes():
    laser = dataclasses.replace(laser_model("generic"), error_share=0.1)
    short = dataclasses.replace(
        laser, laser=dataclasses.replace(laser.laser, range_min_m=7.0, range_max_m=10.0)
    )
    ranges = np.stack([s.ranges_m for s in run(laser=short).scans])
    finite = ranges[np.isfinite(ranges)].astype(np.float64)
    assert np.all((finite >= 7.0) & (finite < 10.0))
    np.testing.assert_allclose(finite, np.rint(finite * 1000.0) / 1000.0, atol=1e-6)
    assert np.mean(np.isinf(ranges)) > 0.1
    whole = np.stack([s.ranges_m for s in run(laser=laser).scans])
    assert np.mean(np.isnan(whole)) == pytest.approx(0.1, abs=0.01)


def test_a_urg_cannot_tell_nothing_from_error():
    ranges = np.stack([s.ranges_m for s in run(laser=laser_model("urg-04lx"), motion=LINE).scans])
    assert np.isnan(ranges).any() and not np.isinf(ranges).any()


def test_late_stamps_and_a_fast_clock():
    """t_ND of -0.15 s: the stamp says 0.15 s more than the instant; the truth is by the wheels' clock."""
    laser = dataclasses.replace(laser_model("generic"), stamp_delay_s=0.15, clock_drift=1e-3)
    simulation = run(laser=laser)
    late_ns = np.rint((simulation.instants_s * 1.001 + 0.15) * 1e9).astype(np.int64)
    assert np.array_equal(simulation.truth_stamps_ns, START_NS + late_ns)
    assert [s.stamp_ns for s in simulation.scans] == simulation.truth_stamps_ns.tolist()
    late = simulation.motion.at((simulation.truth_stamps_ns - START_NS) * 1e-9)
    np.testing.assert_array_equal(simulation.truth_world_T_body, late)


def test_a_wrong_mount_is_reported_but_not_used():
    laser = laser_model("generic")
    turned = dataclasses.replace(laser.laser, body_T_laser=np.array([0.0, 0.0, np.radians(3.0)]))
    honest, wrong = run(laser=laser), run(laser=dataclasses.replace(laser, reported=turned))
    assert all(s.laser is turned for s in wrong.scans)
    for a, b in zip(honest.scans, wrong.scans, strict=True):
        np.testing.assert_array_equal(a.ranges_m, b.ranges_m)


def test_gaps_drops_and_jumps():
    faults = Faults(
        scan_gaps_s=((2.0, 4.0),),
        drop_share=0.2,
        odometry_gaps_s=((5.0, 6.0),),
        odometry_jumps=((7.0, 0.9, 0.0, 1.5),),
    )
    whole, faulty = run(), run(faults=faults)
    assert not np.any((faulty.instants_s >= 2.0) & (faulty.instants_s < 4.0))
    assert 0.6 < len(faulty.scans) / (len(whole.scans) - 20) < 0.95
    stamps = np.array([m.stamp_ns for m in of(Odometry, faulty)])
    times = (stamps - START_NS) * 1e-9
    assert not np.any((times >= 5.0) & (times < 6.0))
    odom = np.stack([m.odom_T_body for m in of(Odometry, faulty)])
    steps = se2.between(odom[:-1], odom[1:])
    (jump,) = np.flatnonzero(np.abs(steps[:, 2]) > 1.0)
    assert times[jump + 1] == pytest.approx(7.0)
    np.testing.assert_allclose(steps[jump + 1 :, 2], 0.4 * np.diff(times)[jump + 1 :], atol=1e-4)


def test_gyro_and_compass():
    robot = RobotModel(
        wheels=FINE,
        gyro_rate_hz=100.0,
        gyro_scale_error=0.02,
        gyro_bias_rad_s=0.01,
        compass_sigma_rad=0.03,
        compass_bias_rad=0.1,
    )
    simulation = run(robot)
    imu = of(Imu, simulation)
    assert len(imu) == 1001
    rates = np.array([m.yaw_rate_rad_s for m in imu[:-1]])
    assert np.mean(rates) == pytest.approx(0.4 * 1.02 + 0.01, abs=3e-4)
    assert np.std(rates) == pytest.approx(0.002, rel=0.1)
    truth = simulation.truth_at(np.array([m.stamp_ns for m in imu]))[:, 2]
    error = se2.wrap(np.array([m.yaw_rad for m in imu]) - truth)
    assert np.mean(error) == pytest.approx(0.1, abs=0.005)
    assert np.std(error) == pytest.approx(0.03, rel=0.1)


def test_messages_come_as_they_would_arrive():
    """A scan after its last beam; every stamp an int; nothing before its time."""
    simulation = run()
    arrivals = [
        m.stamp_ns + (round(m.laser.offsets_s.max() * 1e9) if isinstance(m, Scan) else 0)
        for m in simulation.messages
    ]
    assert arrivals == sorted(arrivals)
    assert all(type(m.stamp_ns) is int for m in simulation.messages)


def test_no_odometry_at_all():
    simulation = run(RobotModel(odometry="none"))
    assert len(simulation.messages) == len(simulation.scans)
    assert all(s.odom_T_body is None for s in simulation.scans)


def test_same_seed_same_log_and_noise_streams_are_apart():
    slipping = RobotModel(slip_m_per_sqrt_m=0.01)
    a, b, c = run(slipping, seed=5), run(slipping, seed=5), run(slipping, seed=6)
    quiet = run(RobotModel(), seed=5)
    for x, y in zip(a.scans, b.scans, strict=True):
        np.testing.assert_array_equal(x.ranges_m, y.ranges_m)
        np.testing.assert_array_equal(x.odom_T_body, y.odom_T_body)
    assert not np.array_equal(a.scans[3].ranges_m, c.scans[3].ranges_m)
    np.testing.assert_array_equal(a.scans[3].ranges_m, quiet.scans[3].ranges_m)
    assert not np.array_equal(a.scans[-1].odom_T_body, quiet.scans[-1].odom_T_body)


def test_a_motion_too_short_for_a_scan_is_told():
    with pytest.raises(MfslamError, match="no scan fits"):
        run(motion=Motion.from_twists([0.01], [[0.0, 0.0, 0.0]]))


def test_unknown_laser_names_the_nearest():
    with pytest.raises(MfslamError, match="did you mean urg-04lx"):
        laser_model("urg-04l")


def test_the_demo_is_fast_and_its_odometry_visibly_wrong():
    demo = demo_simulation()
    assert 60.0 < demo.motion.duration_s < 100.0
    assert np.max(demo.motion.twists[:, 0]) > 2.5 and np.max(np.abs(demo.motion.twists[:, 2])) > 1.5
    error = se2.between(
        demo.truth_world_T_body[-1], se2.compose(demo.truth_world_T_body[0], demo.scans[-1].odom_T_body)
    )
    assert np.hypot(*error[:2]) > 1.0 and abs(error[2]) > 0.3
