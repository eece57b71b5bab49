"""The talk with a Hokuyo, against a simulated one that speaks byte by byte; time passes as it is read."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from virtual_line import Room, VirtualLine, first, until

from drivers.base import SensorTrouble
from drivers.host_clock import HostClock
from drivers.scip.sensor import UrgSensor
from drivers.simulator.devices.urg import SimulatedUrg
from drivers.simulator.devices.wire import LineFault, LineFaults, Wire
from mfslam.config import Config
from mfslam.settings import load
from mfslam.types import MfslamError, Scan

DRIFT = 60e-6


class Rig:
    """A sensor, a simulated device, and the line between."""

    def __init__(
        self,
        faults: LineFaults | None = None,
        settings: tuple[str, ...] = (),
        host_baud: int | None = None,
        room: Room | None = None,
        **device: object,
    ) -> None:
        self.room = room or Room()
        options = {"timer_ms": 5e5, "drift": DRIFT, "start_s": 99.0} | device
        self.urg = SimulatedUrg(self.room, **options)
        self.wire = Wire(self.urg, faults or LineFaults(), paced=host_baud is not None)
        self.line = VirtualLine(self.wire, host_baud)
        self.sensor = self.sensor_with(load(settings=settings))
        if host_baud is not None and not any("baud" in s for s in settings):
            self.sensor.baud = host_baud

    def sensor_with(self, config: Config) -> UrgSensor:
        line = self.line
        return UrgSensor("line", config, clock=HostClock(0.0, 0), open_line=line.open, pause=line.pause)

    def scans(self, count: int) -> list[Scan]:
        found = [m for m in first(self.sensor.messages(until(self.line, 1e6)), count) if isinstance(m, Scan)]
        self.check(found)
        return found

    def scans_until(self, end_s: float) -> list[Scan]:
        found = [m for m in self.sensor.messages(until(self.line, end_s)) if isinstance(m, Scan)]
        self.check(found)
        return found

    def truth(self) -> dict[int, float]:
        """Instant of the first beam by number of the turn."""
        urg = self.room.urg
        to_first_s = urg.first_step / urg.steps_per_turn * self.room.period_s
        return {
            round((float(str(b.record["step_0_s"])) - 99.0) / self.room.period_s): float(
                str(b.record["step_0_s"])
            )
            + to_first_s
            for b in self.wire.carried
            if b.record
        }

    def missed(self, scans: list[Scan]) -> list[float]:
        """When scans began that came over whole and are not there."""
        got = {scan.ranges_m.tobytes() for scan in scans}
        whole = [b.record for b in self.wire.carried if b.intact and b.record]
        return [float(str(r["step_0_s"])) for r in whole if _metres(r["values"]).tobytes() not in got]

    def check(self, scans: list[Scan]) -> None:
        """Every scan is one that was sent, stamped when it was sensed."""
        truth = self.truth()
        for scan in scans:
            if scan.ranges_m.size == 682:
                turn = min(truth, key=lambda t: abs(truth[t] - scan.stamp_ns * 1e-9))
                assert scan.stamp_ns * 1e-9 == pytest.approx(truth[turn], abs=3e-3)
                expected = self.room.values(turn * self.room.period_s) * 1e-3
                # a line's sum has six bits: it misses one pair of flipped bits in twenty
                assert np.isclose(scan.ranges_m, expected.astype(np.float32), atol=1e-6).sum() >= 680


def _metres(values: object) -> np.ndarray:
    return (np.array(values) * 1e-3).astype(np.float32)


def test_scans_over_usb_are_whole_and_stamped_when_they_were_sensed() -> None:
    rig = Rig()
    scans = rig.scans(100)
    assert np.diff([s.stamp_ns for s in scans]) == pytest.approx(1e8, abs=1.1e6)
    laser = scans[0].laser
    assert math.degrees(laser.angles_rad[0]) == pytest.approx(-119.53, abs=0.01)
    assert math.degrees(laser.angles_rad[-1]) == pytest.approx(119.88, abs=0.01)
    assert laser.offsets_s[-1] == pytest.approx(681 / 1024 * 0.1)
    assert (laser.range_min_m, laser.range_max_m) == pytest.approx((0.02, 5.6))
    assert rig.sensor.health.rate_hz == pytest.approx(10.0, abs=0.1) and not sum(
        rig.sensor.health.errors.values()
    )
    assert 0.065 < rig.sensor.health.delay_s < 0.075


def test_a_sensor_that_wakes_up_in_scip_1_at_19200_baud_is_taken_to_250000() -> None:
    rig = Rig(settings=("scip.baud=250000",), host_baud=115200, scip1=True, baud=19200)
    scans = rig.scans(30)
    assert rig.urg.baud == 250000 and not rig.urg.scip1
    # 2137 bytes at 250000 baud are 85 ms: every scan gets through
    assert np.diff([s.stamp_ns for s in scans]) == pytest.approx(1e8, abs=1.1e6)


def test_a_slow_line_cannot_carry_every_scan() -> None:
    rig = Rig(host_baud=115200, baud=115200)
    gaps = np.diff([s.stamp_ns for s in rig.scans(40)]) * 1e-8
    assert np.all(np.rint(gaps) == 2)  # 185 ms each
    assert "25 of 50 scans do not get through: try scip.baud" in rig.sensor.health.advice
    half = Rig(settings=("scip.cluster=2",), host_baud=115200, baud=115200).scans(30)
    assert np.rint(np.diff([s.stamp_ns for s in half]) * 1e-8).max() == 1 and half[0].ranges_m.size == 341


def test_the_timer_wraps_unnoticed() -> None:
    rig = Rig(timer_ms=(1 << 24) - 5000.0)
    stamps = np.array([s.stamp_ns for s in rig.scans(120)])
    assert np.diff(stamps) == pytest.approx(1e8, abs=1.1e6)


def test_what_a_timestamp_marks_is_a_setting() -> None:
    stamps = []
    for where in ("step-0", "rear"):
        stream = Rig(settings=(f"scip.timestamp_at={where}",)).sensor.messages(lambda: False)
        stamps.append(next(stream).stamp_ns)
    assert stamps[1] - stamps[0] == pytest.approx(12.5e6, abs=1e5)


def test_part_of_the_view_merged_and_in_two_characters() -> None:
    settings = ("scip.angle_min_deg=-45", "scip.angle_max_deg=45", "scip.cluster=3", "scip.short_ranges=true")
    scans = Rig(settings=(*settings, "scip.skip_scans=1")).scans(5)
    laser = scans[0].laser
    assert laser.angles_rad.size == 86 and laser.range_max_m == 4.095
    assert math.degrees(laser.angles_rad[0]) == pytest.approx(-45 + 360 / 1024)  # middle of three steps
    assert np.diff([s.stamp_ns for s in scans]) == pytest.approx(2e8, abs=1.1e6)


def test_scans_left_out_on_purpose_are_not_missed() -> None:
    rig = Rig(settings=("scip.skip_scans=2",))
    rig.scans(60)
    assert not rig.sensor.health.advice


def test_each_scan_asked_for() -> None:
    rig = Rig(settings=("scip.mode=ask",), faults=LineFaults(once=(LineFault(3.0, "laser-off"),)))
    stamps = np.diff([s.stamp_ns for s in rig.scans(80)])
    assert np.median(stamps) == pytest.approx(1e8, abs=1.1e6) and np.all(stamps > 0)
    assert rig.sensor.health.errors["laser-off"] == 1


def test_the_true_pace_of_the_mirror_is_found() -> None:
    rig = Rig(room=Room(motor_error=-0.02))  # 98 ms a turn
    scans = rig.scans(80)
    assert scans[-1].laser.offsets_s[-1] == pytest.approx(681 / 1024 * 0.098, rel=1e-3)


def test_flipped_bits_cost_the_scans_they_hit_and_no_other() -> None:
    rig = Rig(LineFaults(bit_flips=1e-4))
    scans = rig.scans_until(160.0)
    whole = sum(b.intact for b in rig.wire.carried)
    assert whole <= len(scans) + 1  # a flip in the echo, which has no sum, loses nothing either
    assert 50 < len(scans) < len(rig.wire.carried) and not rig.sensor.health.advice
    assert rig.sensor.health.errors["checksum"] + rig.sensor.health.errors["cut"] > 100


@pytest.mark.parametrize("seed", [0, 1, 2, 15])
def test_every_scan_that_comes_over_whole_is_given_whatever_driver_and_sensor_talk_of(seed: int) -> None:
    """Flipped bits in requests and answers, and reasons to negotiate anew."""
    once = (
        LineFault(6.0, "status", 72), LineFault(9.0, "laser-off"), LineFault(13.0, "stall", 2.5), LineFault(17.0, "unplug", 1.0),
        LineFault(21.0, "garbage", 300), LineFault(22.0, "status", 21), LineFault(25.0, "status", 72),
    )  # fmt: skip
    rig = Rig()
    rig.wire = rig.line.wire = Wire(rig.urg, LineFaults(1e-4, once), seed=seed, paced=False)
    scans = rig.scans_until(130.0)
    assert len(scans) > 15 and rig.missed(scans) == []


def bent(rig: Rig, request: bytes, times: int) -> None:
    """The sensor's next answers to a request come over with a bit flipped."""
    answer, left = rig.urg._reply, [times]

    def reply(echo: bytes, status: str, lines: tuple[bytes, ...] = ()) -> None:
        if echo.startswith(request) and left[0]:
            left[0] -= 1
            echo = bytes([echo[0] ^ 1]) + echo[1:]
        answer(echo, status, lines)

    rig.urg._reply = reply  # type: ignore[method-assign]


def test_scans_that_come_before_the_answer_to_their_request_is_understood_are_given() -> None:
    rig = Rig()
    bent(rig, b"MD", times=3)  # each is waited for, while the sensor measures already
    scans = rig.scans_until(104.0)
    assert len(scans) > 25 and rig.missed(scans) == []
    assert np.diff([s.stamp_ns for s in scans]).max() < 4e8


@pytest.mark.parametrize("asked", [b"MD0044072501000\n", b"MD0100050002000\n", b"MS0044072501000\n"])
def test_a_sensor_that_still_measures_for_another_program_loses_nothing(asked: bytes) -> None:
    rig = Rig()
    rig.urg.receive(asked, 99.5)
    quit_at_once, refusals = rig.urg._quit, [6]

    def quit_late(request: bytes, command: bytes, now_s: float) -> None:
        if refusals[0]:
            refusals[0] -= 1
        else:
            quit_at_once(request, command, now_s)

    rig.urg._quit = quit_late  # type: ignore[method-assign]
    scans = rig.scans_until(106.0)
    assert len({s.ranges_m.size for s in scans}) == (2 if asked.startswith(b"MD01") else 1)
    assert rig.missed(scans) == [] and np.all(np.diff([s.stamp_ns for s in scans]) > 0)
    early = scans[0].laser
    first_step, cluster = (100.5, 2) if asked.startswith(b"MD01") else (44, 1)
    assert early.angles_rad[0] == pytest.approx((first_step - 384) * math.tau / 1024)
    assert early.angles_rad[1] - early.angles_rad[0] == pytest.approx(cluster * math.tau / 1024)


def test_what_is_under_way_when_the_driver_stops_is_given() -> None:
    for end_s in (104.0, 104.03, 104.06, 104.09):
        rig = Rig(host_baud=115200, baud=115200)
        scans = rig.scans_until(end_s)
        for ms in range(300):  # what the sensor had begun to send comes to its end
            rig.wire.to_host(rig.line.time_s + 1e-3 * ms, 115200)
        assert rig.missed(scans) == []


@pytest.mark.parametrize(
    ("right", "bent", "wrong_sums"), [(b"AMIN:44", b"AMIN:45", 1), (b"SCAN:600", b"SCAN:60p", 0)]
)
def test_bent_parameters_of_the_sensor_are_asked_for_again(
    right: bytes, bent: bytes, wrong_sums: int
) -> None:
    rig = Rig()
    info, left = rig.urg._info, [1]

    def one_bit_off(echo: bytes, **told: object) -> None:
        info(echo, **told)
        if "AMIN" in told and left[0]:
            left[0] -= 1
            block = rig.urg._out[-1]
            assert right in block.data
            block.data = block.data.replace(right, bent)

    rig.urg._info = one_bit_off  # type: ignore[method-assign]
    assert rig.scans(3)[0].ranges_m.size == 682 and rig.sensor.health.errors["info-sum"] == wrong_sums


def test_asked_for_scans_whose_echo_is_bent_are_given() -> None:
    rig = Rig(LineFaults(bit_flips=1e-4), settings=("scip.mode=ask",))
    scans = rig.scans_until(115.0)
    assert len(scans) > 12 and rig.missed(scans) == [] and rig.sensor.health.reconnects == 0


@pytest.mark.parametrize("kind", ["garbage", "lost"])
def test_a_burst_of_garbage_or_half_lines_cost_one_scan_each(kind: str) -> None:
    faults = tuple(LineFault(at, kind, 300) for at in (3.0, 4.05, 5.1))  # type: ignore[arg-type]
    rig = Rig(LineFaults(once=faults))
    scans = rig.scans_until(112.0)
    whole = [b for b in rig.wire.carried if b.intact]
    assert len(whole) - len(scans) <= 1 and len(scans) >= len(rig.wire.carried) - 4


@pytest.mark.parametrize(("fault", "lost_s"), [("unplug", 2.0), ("power", 2.0), ("laser-off", 0.0)])
def test_the_sensor_is_found_again(fault: str, lost_s: float) -> None:
    rig = Rig(LineFaults(once=(LineFault(4.0, fault, lost_s),)), scip1=True)  # type: ignore[arg-type]
    scans = rig.scans_until(115.0)
    stamps = np.array([s.stamp_ns for s in scans]) * 1e-9
    assert np.all(np.diff(stamps) > 0) and stamps[-1] > 114.5
    assert np.max(np.diff(stamps)) < lost_s + 5.0
    assert rig.sensor.health.connected and rig.sensor.health.reconnects == 1


def test_a_sensor_that_verifies_an_error_is_waited_for() -> None:
    rig = Rig(LineFaults(once=(LineFault(4.0, "status", 21),)))
    scans = rig.scans_until(110.0)
    errors = rig.sensor.health.errors
    assert errors["status-21"] == 1 and errors["status-98"] == 1 and scans[-1].stamp_ns > 109.5e9
    assert rig.sensor.health.reconnects == 0


def test_hardware_trouble_is_reset_and_told() -> None:
    rig = Rig(LineFaults(once=(LineFault(4.0, "status", 72),)))
    scans = rig.scans_until(112.0)
    assert rig.sensor.health.errors["status-72"] == 1 and scans[-1].stamp_ns > 111.5e9


def test_a_pause_of_the_sensor_bends_no_stamp() -> None:
    rig = Rig(LineFaults(once=(LineFault(6.0, "stall", 0.9),)))
    rig.scans_until(140.0)
    assert rig.sensor.health.reconnects == 0


FAULTS = st.builds(
    LineFault,
    st.floats(8.0, 20.0),
    st.sampled_from(["garbage", "lost", "unplug", "power", "stall", "status", "laser-off"]),
    st.sampled_from([1.0, 21.0, 55.0, 98.0, 3.0]),
)


@given(
    once=st.lists(FAULTS, max_size=5),
    flips=st.sampled_from([0.0, 1e-5]),
    serial=st.booleans(),
    seed=st.integers(0, 9),
)
@settings(max_examples=15)
def test_whatever_happens_scans_are_right_and_come_again(
    once: list[LineFault], flips: float, serial: bool, seed: int
) -> None:
    once = [
        f if f.kind in ("garbage", "lost", "status") else replace(f, value=min(f.value, 3.0)) for f in once
    ]
    rig = Rig(LineFaults(flips, tuple(once)), host_baud=115200 if serial else None, baud=115200, scip1=True)
    rig.wire = rig.line.wire = Wire(rig.urg, LineFaults(flips, tuple(once)), seed=seed, paced=serial)
    scans = rig.scans_until(150.0)  # each scan is checked there
    assert scans[-1].stamp_ns > 148.5e9 and rig.sensor.health.connected


def test_a_sensor_that_is_not_there_is_told_at_once() -> None:
    rig = Rig(LineFaults(once=(LineFault(0.0, "stall", 1e9),)))
    with pytest.raises(SensorTrouble, match="urg:line: no SCIP sensor answers"):
        rig.scans(1)


def test_a_view_that_the_sensor_has_not_is_refused() -> None:
    with pytest.raises(MfslamError, match=r"from -119\.53 to 119\.88 deg"):
        Rig(settings=("scip.angle_min_deg=-170",)).scans(1)


def test_error_codes_are_counted_and_never_ranges() -> None:
    rig = Rig()
    rig.room.values = lambda t: np.where(np.arange(682) < 10, np.arange(682), 1000)  # type: ignore[method-assign]
    scan = next(rig.sensor.messages(lambda: False))
    assert isinstance(scan, Scan)
    assert np.isnan(scan.ranges_m[:10]).all() and np.all(scan.ranges_m[10:] == 1.0)
    assert rig.sensor.range_codes["intensity too low"] == 2


def test_presets_keep_their_ranges_and_mount() -> None:
    config = load(settings=("sensor.range_max_m=4.0", "sensor.mount_x_m=0.1", "sensor.stamp_at=last"))
    rig = Rig()
    scan = next(rig.sensor_with(config).messages(lambda: False))
    assert isinstance(scan, Scan)
    assert scan.laser.range_max_m == 4.0 and scan.laser.body_T_laser[0] == 0.1
    assert scan.laser.offsets_s[0] == 0.0 and Config().scip.baud is None
