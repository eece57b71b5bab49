"""One time line although clocks jump, and instants of scans although they come in bursts."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mfslam.config import Config, ImuConfig
from mfslam.heading import HeadingTrack
from mfslam.motion import MotionSources
from mfslam.odometry import OdometryTrack, begins_anew
from mfslam.stamps import ScanPace, StampClock, SteadyPace
from mfslam.types import Findings, Imu, Odometry, WheelTicks

EPOCH_NS = 1_600_000_000_000_000_000


def imu(stamp_ns):
    return Imu(stamp_ns, 0.0, None)


def odometry(stamp_ns):
    return Odometry(stamp_ns, np.zeros(3))


def two_sources(jump_s, at_s=2.0):
    """(true time, message): odometry at 50 Hz and a gyro at 100 Hz, on one clock that jumps."""
    for k in range(400):
        t = 0.01 * k
        stamp = EPOCH_NS + k * 10**7 + (round(jump_s * 1e9) if t >= at_s else 0)
        if k % 2 == 0:
            yield t, odometry(stamp)
        yield t, imu(stamp)


@settings(max_examples=40, deadline=None, derandomize=True)
@given(st.one_of(st.floats(6.0, 1e7), st.floats(-1e7, -1.5)))
def test_times_go_on_over_a_jump_of_the_clock(jump_s):
    """True times for every kind of messages, and one finding for a jump that all of them made."""
    findings = Findings()
    clock = StampClock(findings)
    for t, message in two_sources(jump_s):
        assert clock.place(message)[0] == pytest.approx(t, abs=1e-6)
    assert findings.count("clock-jump") == 1
    ((_, finding),) = findings
    assert finding.first_where.endswith(f"by {jump_s:+.3f} s")


def test_every_kind_of_messages_is_told_of_the_jump():
    clock = StampClock(Findings())
    told = [(type(m), clock.place(m)[1]) for _, m in two_sources(100.0)]
    jumps = [(kind, jump_s) for kind, jump_s in told if jump_s]
    assert [kind for kind, _ in jumps] == [Odometry, Imu]
    np.testing.assert_allclose([jump_s for _, jump_s in jumps], 100.0, atol=1e-6)


@settings(max_examples=20, deadline=None, derandomize=True)
@given(st.floats(-0.95, 4.9))
def test_small_leaps_are_stamps_that_lie_or_gaps(jump_s):
    clock = StampClock(findings := Findings())
    for t, message in two_sources(jump_s):
        assert clock.place(message)[0] == pytest.approx(t + (jump_s if t >= 2.0 else 0.0), abs=1e-6)
    assert len(findings) == 0


def test_a_source_that_is_silent_while_others_speak_has_not_jumped():
    clock = StampClock(findings := Findings())
    clock.place(odometry(EPOCH_NS))
    for k in range(6000):
        clock.place(imu(EPOCH_NS + k * 10**7))
    assert clock.place(odometry(EPOCH_NS + 60 * 10**9)) == (pytest.approx(60.0), 0.0)
    assert len(findings) == 0


def test_kinds_of_messages_on_clocks_of_their_own_do_not_disturb_each_other():
    clock = StampClock(findings := Findings())
    for k in range(100):
        clock.place(odometry(EPOCH_NS + k * 10**8))
        assert clock.place(imu(k * 10**8))[1] == 0.0
    assert len(findings) == 0


def test_a_jump_there_and_back_is_two():
    clock = StampClock(findings := Findings())
    shift = np.repeat([0, 100, 0], 50) * 10**9
    times = [clock.place(odometry(EPOCH_NS + k * 10**8 + int(shift[k])))[0] for k in range(150)]
    np.testing.assert_allclose(times, 0.1 * np.arange(150), atol=1e-6)
    assert findings.count("clock-jump") == 2


# --- bursts ---


def burst_stamps(burst, count, period_s=0.1):
    """(stamp, true instant) of scans that are handed over together, 1 ms apart, stamped then."""
    for k in range(count):
        last = k - k % burst + burst - 1
        yield last * period_s + k % burst * 0.001, k * period_s


@settings(max_examples=20, deadline=None, derandomize=True)
@given(st.integers(1, 10))
def test_scans_in_bursts_were_sensed_one_usual_step_apart(burst):
    stamps, true_s = zip(*burst_stamps(burst, 40 * burst), strict=True)
    gaps = [*np.diff(stamps), None]
    pace = ScanPace()
    sensed = np.array([pace.sensed_s(s, g) for s, g in zip(stamps, gaps, strict=True)])
    settled = slice(10 * burst + 10, None)
    # stamps of a burst are up to (burst - 1) * 0.1 s late; the period is known to a burst's share of the memory
    np.testing.assert_allclose(sensed[settled], np.array(true_s)[settled], atol=0.011 * burst)
    assert np.all(sensed <= np.array(stamps))


def test_stamps_that_are_regular_are_kept_as_they_are():
    """With jitter, and scans lost: nothing is a burst."""
    rng = np.random.default_rng(1)
    stamps = np.flatnonzero(rng.random(300) < 0.7) * 0.1 + rng.uniform(0.0, 0.05, 300)[:1]
    stamps = stamps + rng.uniform(-0.02, 0.02, stamps.size)
    pace = ScanPace()
    sensed = [pace.sensed_s(s, g) for s, g in zip(stamps, [*np.diff(stamps), None], strict=True)]
    np.testing.assert_array_equal(sensed, stamps)


def test_scans_lost_before_a_burst_are_not_made_up():
    """A silence of 3 s, then a burst of four: its first scan is 0.3 s old, not 2.9 s."""
    stamps = [s for s, _ in burst_stamps(4, 80)] + [11.0 + s for s, _ in burst_stamps(4, 4)]
    pace = ScanPace()
    sensed = [pace.sensed_s(s, g) for s, g in zip(stamps, [*np.diff(stamps), None], strict=True)]
    np.testing.assert_allclose(sensed[-4:], 11.0 + 0.1 * np.arange(4), atol=0.15)


# --- what wheels and gyro make of it ---


def test_wheels_set_back_to_their_origin_are_a_break_however_long_it_took():
    assert begins_anew(np.array([3.0, 0.0, 0.0]), np.zeros(3))
    assert begins_anew(np.array([0.0, 0.0, 1.0]), np.zeros(3))
    assert not begins_anew(np.array([0.3, 0.0, 0.1]), np.zeros(3)), "driven home"
    assert not begins_anew(np.array([3.0, 0.0, 0.0]), np.array([2.9, 0.0, 0.0]))
    sources = MotionSources(Config(), Findings())
    for k in range(100):
        sources.add(Odometry(EPOCH_NS + k * 10**8, np.array([0.1 * k, 0.0, 0.0])))
    for k in range(100):
        sources.add(Odometry(EPOCH_NS + 14 * 10**9 + k * 10**8, np.array([0.1 * k, 0.0, 0.0])))
    assert sources.findings.count("odometry-restart") == 1
    assert sources.odometry.is_broken(9.95, 13.95) and not sources.odometry.is_broken(14.1, 20.0)
    np.testing.assert_allclose(sources.odometry.odom_T_body[-1], [19.8, 0.0, 0.0], atol=1e-9)


def test_counters_that_begin_anew_after_a_clock_jump_are_no_motion():
    """100 s would be time enough for any step; the wheels' track is broken there and nowhere else."""
    sources = MotionSources(Config(), Findings())
    for k in range(100):
        sources.add(WheelTicks(EPOCH_NS + k * 10**8, 1000 + 500 * k, 1000 + 500 * k))
    before = sources.odometry.odom_T_body[-1]
    sources.add(WheelTicks(EPOCH_NS + 110 * 10**9, 0, 0))
    np.testing.assert_array_equal(sources.odometry.odom_T_body[-1], before)
    assert sources.odometry.is_broken(9.9, 10.0) and not sources.odometry.is_broken(0.0, 9.8)
    assert sources.findings.count("clock-jump") == 1


def test_a_pause_gives_the_wheels_time():
    """3 m within a step of 0.1 s are a jump; the log having paused for a minute, they were driven."""
    for pause_s, broken in ((0.0, True), (60.0, False)):
        track = OdometryTrack()
        for k in range(20):
            track.add(0.1 * k, np.array([0.1 * k, 0.0, 0.0]))
        track.add(2.0, np.array([4.9, 0.0, 0.0]), pause_s)
        assert track.is_broken(1.95, 2.0) == broken


def test_the_gyro_tells_no_turn_over_a_clock_jump():
    track = HeadingTrack(ImuConfig())
    for k in range(100):
        track.add(0.01 * k, Imu(0, 1.0, None), after_gap=k == 50)
    assert track.turn(0.4, 0.6) is None
    assert track.turn(0.6, 0.9) == pytest.approx(0.3)


@pytest.mark.parametrize("jitter_s", [0.0, 0.005, 0.01])
def test_scans_of_a_steady_laser_are_put_in_its_turn_whatever_their_stamps_scatter(jitter_s):
    rng = np.random.default_rng(0)
    turns = np.cumsum(rng.choice([1, 1, 1, 1, 2], 600))  # some scans are lost
    true_s = 0.0987 * turns
    pace = SteadyPace()
    stamps_s = true_s + jitter_s * rng.standard_normal(600)
    at_once_s = np.array([pace.sensed_s(float(t)) for t in stamps_s])
    settled_s = at_once_s + pace.settle()
    assert np.std((at_once_s - true_s)[128:]) <= 0.3 * jitter_s + 1e-9
    assert np.std((settled_s - true_s)[64:-64]) <= 0.15 * jitter_s + 1e-9
    np.testing.assert_allclose(pace.settle(), 0.0, atol=1e-12)


def test_a_pace_that_wanders_by_itself_is_left_as_stamped():
    stamps_s = np.cumsum(0.1 + 0.02 * np.random.default_rng(1).standard_normal(2000))
    pace = SteadyPace()
    off_s = np.array([pace.sensed_s(float(t)) for t in stamps_s]) - stamps_s
    assert np.mean(off_s == 0.0) > 0.9
    pace.settle()
    assert np.mean(np.array(pace._sensed_s) == stamps_s) > 0.8


def test_after_a_pause_the_turning_is_learned_anew():
    stamps_s = np.concatenate([0.1 * np.arange(100), 30.037 + 0.1 * np.arange(100)])
    pace = SteadyPace()
    np.testing.assert_allclose([pace.sensed_s(float(t)) for t in stamps_s], stamps_s, atol=1e-9)
