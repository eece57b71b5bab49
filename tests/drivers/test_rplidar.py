"""RPLIDAR lasers, against a simulated one that speaks byte by byte; time passes as it is read, but for the last tests."""

from __future__ import annotations

import json
import math
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from virtual_line import VirtualLine, first, until

from drivers.base import SensorTrouble
from drivers.host_clock import HostClock
from drivers.rplidar import protocol
from drivers.rplidar.protocol import PointParser, answer_in, descriptor, point, request
from drivers.rplidar.sensor import MODELS, RplidarSensor
from drivers.simulator.devices.rplidar import SimulatedRplidar
from drivers.simulator.devices.serve import Cast, SimulatedSensors
from drivers.simulator.devices.wire import LineFault, LineFaults, Wire
from mfslam.config import Config
from mfslam.types import IntArray, MfslamError, Scan

START_S = 99.0


class Turning:
    """A scene whose ranges tell beam and turn."""

    def __init__(self, points: int = 400, period_s: float = 0.1) -> None:
        self.points, self.period_s = points, period_s

    def values(self, step_0_s: float) -> IntArray:
        turn = round(step_0_s / self.period_s)
        return np.asarray(1000 + 4 * np.arange(self.points) + turn % 100, dtype=np.int64)


class InPackets(VirtualLine):
    """As over a USB adapter that sends what it has every 16 ms."""

    def read(self, timeout_s: float) -> bytes:
        end_s, out = self.time_s + max(timeout_s, 0.016), b""
        while self.time_s < end_s and not (out and self.time_s % 0.016 < 1e-3):
            out += super().read(1e-3)
        return out


class Rig:
    def __init__(
        self, model: str = "A2", faults: LineFaults | None = None, line: type[VirtualLine] = VirtualLine,
        scene: Turning | None = None, baud: int | None = None, seed: int = 0, **device: object,
    ) -> None:  # fmt: skip
        baud = baud or MODELS[model].bauds[0]
        self.scene = scene or Turning(200 if baud == 115200 else 400)  # more the line does not carry
        options = {"baud": baud, "start_s": START_S} | device
        self.device = SimulatedRplidar(self.scene, model.lower(), **options)  # type: ignore[arg-type]
        self.line = line(Wire(self.device, faults or LineFaults(), seed=seed), baud)
        clock = HostClock(0.0, 0)
        self.sensor = RplidarSensor(
            model, "line", Config(), clock=clock, open_line=self.line.open, pause=self.line.pause
        )

    def scans(self, count: int) -> list[Scan]:
        return [m for m in first(self.sensor.messages(until(self.line, 1e6)), count) if isinstance(m, Scan)]

    def scans_until(self, end_s: float) -> list[Scan]:
        return [m for m in self.sensor.messages(until(self.line, end_s)) if isinstance(m, Scan)]

    def late_s(self, scans: list[Scan]) -> list[float]:
        """Of each scan, by the turn that its ranges tell."""
        out = []
        for scan in scans:
            begun = (scan.stamp_ns * 1e-9 - START_S) / self.scene.period_s
            seen = np.isfinite(scan.ranges_m)
            told = np.rint(scan.ranges_m[seen] * 1e3) - 1000 - 4 * np.flatnonzero(seen)
            turn = float(np.median(told))
            nearest = round((begun - turn) / 100) * 100 + turn
            out.append((begun - nearest) * self.scene.period_s)
        return out


@pytest.mark.parametrize("model", list(MODELS))
def test_turns_become_scans_whose_beams_have_their_own_instants(model: str) -> None:
    rig = Rig(model)
    scans = rig.scans(30)
    laser, points = scans[0].laser, rig.scene.points
    assert laser.name == f"rplidar-{model.lower()}" and laser.range_max_m == MODELS[model].range_max_m
    np.testing.assert_allclose(laser.angles_rad, -np.arange(points) * math.tau / points, atol=1e-9)
    np.testing.assert_allclose(laser.offsets_s, np.arange(points) / points * 0.1, atol=5e-4)
    for scan in scans:
        turn = round(float(scan.ranges_m[0] * 1e3)) - 1000
        np.testing.assert_allclose(scan.ranges_m, (1000 + 4 * np.arange(points) + turn) * 1e-3, atol=1.5e-3)
    assert max(map(abs, rig.late_s(scans))) < 2e-3
    assert rig.sensor.health.errors["bent"] == 0
    assert rig.sensor.health.rate_hz == pytest.approx(10.0, abs=0.2)


def test_packets_of_an_adapter_and_a_slow_motor_bend_no_stamp() -> None:
    rig = Rig("A3", line=InPackets, scene=Turning(period_s=0.11))
    scans = rig.scans(60)
    assert scans[-1].laser.offsets_s[-1] == pytest.approx(0.11 * 399 / 400, rel=0.03)
    assert np.percentile(np.abs(rig.late_s(scans[10:])), 95) < 4e-3


def test_an_a2_is_found_at_its_other_bit_rate_and_without_a_board_for_its_motor() -> None:
    rig = Rig("A2", baud=256000, adapter=False)
    assert len(rig.scans(5)) == 5 and rig.sensor.baud == 256000
    assert rig.sensor.info is not None and rig.sensor.info.series == 2


def test_the_motor_stops_when_we_leave() -> None:
    for model in ("A2", "S2"):
        rig = Rig(model)
        rig.scans_until(103.0)
        assert not rig.device.turning and not rig.device.scanning


def test_one_that_still_measures_for_another_program_is_taken_over() -> None:
    rig = Rig(scanning=True)
    assert len(rig.scans(5)) == 5


@pytest.mark.parametrize("seed", range(3))
def test_flipped_bits_garbage_lost_bytes_and_a_pulled_cable(seed: int) -> None:
    once = (
        LineFault(3.0, "garbage", 300), LineFault(4.0, "lost", 33), LineFault(5.0, "unplug", 1.0),
    )  # fmt: skip
    rig = Rig("A2", LineFaults(1e-4, once), seed=seed)
    scans = rig.scans_until(115.0)
    assert rig.sensor.health.reconnects == 1 and scans[-1].stamp_ns > 114.5e9
    assert np.all(np.diff([s.stamp_ns for s in scans]) > 0) and len(scans) > 100
    seen = np.array([np.isfinite(s.ranges_m).mean() for s in scans])
    assert (seen > 0.9).mean() > 0.9  # 40 bits a point, of which ten or so are checked
    turns = [round(float(np.nanmedian(s.ranges_m * 1e3 - 1000 - 4 * np.arange(200)))) for s in scans]
    wrong = [
        np.mean(np.abs(s.ranges_m * 1e3 - 1000 - 4 * np.arange(200) - turn) > 10)
        for s, turn in zip(scans, turns, strict=True)
    ]
    assert np.mean(wrong) < 0.02 and rig.sensor.health.errors["bent"] > 10
    late = np.abs(rig.late_s(scans))
    assert np.percentile(late, 95) < 5e-3


def test_a_sensor_that_protects_itself_is_reset_and_a_broken_one_is_told() -> None:
    rig = Rig(health=2)
    assert len(rig.scans(3)) == 3 and rig.device.health == 0
    with pytest.raises(
        SensorTrouble, match=r"rplidar:A2:line: the sensor says that it is broken \(error 7\)"
    ):
        Rig(health=2, mends=False).scans(1)


def test_what_is_not_there_or_does_not_turn_is_told() -> None:
    with pytest.raises(SensorTrouble, match=r"no RPLIDAR answers \(tried 115200, 256000 baud\)"):
        Rig(faults=LineFaults(once=(LineFault(0.0, "stall", 1e9),))).scans(1)
    with pytest.raises(SensorTrouble, match="the motor does not turn"):
        Rig(faults=LineFaults(once=(LineFault(0.3, "laser-off"),))).scans(1)
    with pytest.raises(MfslamError, match=r"no model 'A9'; known: A1, A2, A3, C1, S1, S2, S3"):
        RplidarSensor("A9", "line", Config())


# --- bytes --------------------------------------------------------------------------------------------


def test_requests_and_answers_as_the_specification_has_them() -> None:
    assert request(protocol.SCAN) == b"\xa5\x20"
    assert request(protocol.MOTOR_PWM, b"\x94\x02") == b"\xa5\xf0\x02\x94\x02\xc1"
    assert descriptor(protocol.SCAN_ANSWER, many=True) == b"\xa5\x5a\x05\x00\x00\x40\x81"
    assert descriptor(protocol.INFO_ANSWER) == b"\xa5\x5a\x14\x00\x00\x00\x04"
    info = protocol.Info.of(bytes([0x28, 29, 1, 5]) + bytes(16))
    assert info.series == 2 and info.firmware == (1, 29)


@given(
    pieces=st.lists(st.integers(1, 40), max_size=30), before=st.binary(max_size=12), lost=st.integers(0, 99)
)
def test_points_survive_any_cutting_and_are_found_again_after_lost_bytes(
    pieces: list[int], before: bytes, lost: int
) -> None:
    whole = [point(k * 0.9, 1000 + k, k == 0) for k in range(400)]
    data = b"".join(whole)
    data = before + data[:lost] + data[lost + 3 :]
    parser, at, angles = PointParser(), 0, []
    for size in [*pieces, len(data)]:
        angles += parser.feed(data[at : at + size]).angles_deg.tolist()
        at += size
    np.testing.assert_allclose(angles[-340:], 0.9 * np.arange(60, 400), atol=0.02)


@given(st.binary(max_size=400))
def test_no_bytes_break_the_parser(data: bytes) -> None:
    parser = PointParser()
    points = parser.feed(data)
    assert np.all(points.angles_deg < 360.0) and np.all(points.after >= 0)
    for kind in protocol.SIZES:
        answer_in(data, kind)


# --- real bytes in real time --------------------------------------------------------------------------


@pytest.mark.parametrize("model", ["A2", "S1"])
def test_over_a_pseudo_terminal_at_its_bit_rate(model: str, tmp_path: Path) -> None:
    record = tmp_path / "sent.jsonl"
    with SimulatedSensors(Cast("demo", laser=f"rplidar-{model.lower()}", record=str(record))) as sim:
        sensor = RplidarSensor(model, str(sim.lidar), Config())
        wall_s = time.time() - time.monotonic()
        end_s = time.monotonic() + 20.0
        scans: list[Scan] = []
        for message in sensor.messages(lambda: len(scans) >= 15 or time.monotonic() > end_s):
            assert isinstance(message, Scan)
            scans.append(message)
    sent = {b["turn_s"]: np.array(b["values"]) for b in map(json.loads, record.read_text().splitlines())}
    late_s = []
    for scan in scans:
        at_s = scan.stamp_ns * 1e-9 - wall_s
        begun_s = min(sent, key=lambda turn_s: abs(turn_s - at_s))
        values = sent[begun_s]
        seen = (values[: scan.ranges_m.size] >= 150) & np.isfinite(scan.ranges_m[: values.size])
        differ = np.abs(scan.ranges_m[: values.size][seen] - values[: scan.ranges_m.size][seen] * 1e-3)
        assert np.median(differ) < 0.01
        late_s.append(at_s - begun_s)
    assert len(scans) >= 15 and abs(np.median(late_s)) < 5e-3  # a busy machine delays single ones
