"""Lasers through lds2d, from the bytes that they send."""

from __future__ import annotations

import math
import struct
from typing import Any

import numpy as np
import pytest
from virtual_line import VirtualLine, first, until

from drivers.base import SensorTrouble
from drivers.host_clock import HostClock
from drivers.lds_sensor import LdsSensor
from drivers.simulator.devices.wire import Block, LineFault, LineFaults, Wire
from mfslam.config import Config
from mfslam.types import MfslamError, Scan

lds2d = pytest.importorskip("lds2d", reason="the extra lds is not installed")


def wall_mm(angle_deg: float) -> int:
    """A room of 4 m by 4 m around the sensor."""
    a = math.radians(angle_deg)
    return round(2000.0 / max(abs(math.cos(a)), abs(math.sin(a))))


class _Turning:
    """Something that turns at 10 Hz from 100 s on and tells ``group`` points at a time, in its own packets."""

    baud, period_s, points, group = 230400, 0.1, 456, 12
    running = True

    def __init__(self) -> None:
        self._next = 0

    def packet(self, k: int) -> bytes:
        raise NotImplementedError

    def receive(self, data: bytes, now_s: float) -> None:
        return

    def speak(self, now_s: float, busy: bool) -> list[Block]:
        out = []
        while 100.0 + (self._next + 1) * self.group / self.points * self.period_s <= now_s:
            if self.running:
                out.append(Block(self.packet(self._next)))
            self._next += 1
        return out

    def obey(self, fault: LineFault, now_s: float) -> None:
        return

    def power_cycle(self, now_s: float) -> None:
        return

    def angle_deg(self, point: int) -> float:
        return (point % self.points) * 360.0 / self.points


class Ld19(_Turning):
    def packet(self, k: int) -> bytes:
        from lds2d.crc import crc8

        angles = [self.angle_deg(k * self.group + n) for n in range(self.group)]
        body = struct.pack("<BBHH", 0x54, 0x2C, 3600, round(angles[0] * 100))
        body += b"".join(struct.pack("<HB", wall_mm(a), 200) for a in angles)
        body += struct.pack("<HH", round(angles[-1] * 100), 0)
        return body + bytes([crc8(body)])


class RplidarA1(_Turning):
    baud, points, group = 115200, 200, 1
    running = False

    def receive(self, data: bytes, now_s: float) -> None:
        if data == b"\xa5\x20":
            self.running = True

    def packet(self, k: int) -> bytes:
        angle = self.angle_deg(k)
        head = (50 << 2) | (1 if k % self.points == 0 else 2)
        return struct.pack("<BHH", head, round(angle * 64) << 1 | 1, wall_mm(angle) * 4)

    def speak(self, now_s: float, busy: bool) -> list[Block]:
        started = self.running and not hasattr(self, "_told")
        if started:
            self._told = True
        descriptor = [Block(b"\xa5\x5a\x05\x00\x00\x40\x81")] if started else []
        return descriptor + super().speak(now_s, busy)


def rig(device: Any, model: str, faults: LineFaults | None = None) -> tuple[LdsSensor, VirtualLine]:
    line = VirtualLine(Wire(device, faults or LineFaults()), device.baud)
    clock = HostClock(0.0, 0)
    return LdsSensor(model, "line", Config(), clock=clock, open_line=line.open, pause=line.pause), line


@pytest.mark.parametrize(("device", "model"), [(Ld19(), "LDROBOT-LD19"), (RplidarA1(), "RPLIDAR-A1")])
def test_turns_become_scans_stamped_when_they_began(device: _Turning, model: str) -> None:
    sensor, line = rig(device, model)
    scans = [m for m in first(sensor.messages(until(line, 1e6)), 30) if isinstance(m, Scan)]
    laser = scans[0].laser
    assert laser.angles_rad.size == device.points and laser.offsets_s[-1] == pytest.approx(0.1, abs=2e-3)
    assert laser.angles_rad[1] < 0.0  # clockwise
    assert np.diff([s.stamp_ns for s in scans]) == pytest.approx(1e8, abs=5e6)
    for scan in scans:
        begun_s = scan.stamp_ns * 1e-9 - 100.0
        assert begun_s / 0.1 == pytest.approx(
            round(begun_s / 0.1), abs=0.07
        )  # 7 ms: packets are sent when they are full
        expected = [wall_mm(math.degrees(-a)) * 1e-3 for a in laser.angles_rad]
        np.testing.assert_allclose(scan.ranges_m, expected, atol=0.03)


def test_an_unplugged_laser_is_found_again_and_bent_packets_are_left_out() -> None:
    faults = LineFaults(bit_flips=1e-5, once=(LineFault(5.0, "unplug", 2.0),))
    sensor, line = rig(Ld19(), "LDROBOT-LD19", faults)
    scans = [m for m in sensor.messages(until(line, 115.0)) if isinstance(m, Scan)]
    assert scans[-1].stamp_ns > 114.5e9 and sensor.health.reconnects == 1
    for scan in scans[5:]:
        seen = np.isfinite(scan.ranges_m)
        assert seen.mean() > 0.5 and np.all(scan.ranges_m[seen] < 2.9)


def test_a_silent_port_and_an_unknown_model_are_told() -> None:
    device = Ld19()
    device.running = False
    sensor, line = rig(device, "LDROBOT-LD19")
    with pytest.raises(SensorTrouble, match="nothing comes"):
        first(sensor.messages(until(line, 1e6)), 1)
    with pytest.raises(MfslamError, match=r"no laser 'SICK-TIM'; known: .*RPLIDAR-A1"):
        LdsSensor("SICK-TIM", "line", Config())
    with pytest.raises(MfslamError, match="motor"):
        LdsSensor("NEATO-XV11", "line", Config())
