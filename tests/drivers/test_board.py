"""Encoder boards, against simulated ones on a line whose time passes as it is read."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from virtual_line import VirtualLine, first, until

from drivers.base import SensorTrouble
from drivers.board.arduino import ArduinoBoard
from drivers.board.protocol import (
    LineSplitter,
    Reading,
    TimeTold,
    crc16,
    parse_line,
    reading_line,
    time_line,
)
from drivers.board.streaming import StreamingBoard
from drivers.host_clock import HostClock
from drivers.live_sensor import LiveSensor
from drivers.simulator.devices.board import ArduinoDevice, StreamingBoardDevice
from drivers.simulator.devices.wire import Device, LineFault, LineFaults, Wire
from mfslam.settings import load
from mfslam.types import Imu, WheelTicks

INT32 = st.integers(-(1 << 31), (1 << 31) - 1)
READINGS = st.builds(
    Reading,
    st.integers(0, (1 << 32) - 1),
    INT32,
    INT32,
    st.none() | st.integers(-20_000_000, 20_000_000),
    st.none() | st.integers(-36000, 36000),
)
TICKS_PER_S = 1000


class Straight:
    """Both wheels turn evenly, the right one backwards; the robot turns at 0.5 rad/s."""

    def ticks(self, at_s: float) -> tuple[int, int]:
        return int(TICKS_PER_S * at_s), -int(TICKS_PER_S * at_s)

    def gyro_rad_s(self, at_s: float) -> float:
        return 0.5

    def heading_rad(self, at_s: float) -> float:
        return math.remainder(0.5 * at_s, 2.0 * math.pi)


def rig(
    device: Device, kind: type[LiveSensor] = StreamingBoard, faults: LineFaults | None = None, *settings: str
) -> tuple[Any, VirtualLine]:
    line = VirtualLine(Wire(device, faults or LineFaults()), device.baud)
    config = load(settings=settings)
    sensor = kind("line", config, clock=HostClock(0.0, 0), open_line=line.open, pause=line.pause)  # type: ignore[arg-type,call-arg]
    return sensor, line


def board(**options: Any) -> StreamingBoardDevice:
    return StreamingBoardDevice(Straight(), **({"start_s": 99.0, "drift": -80e-6} | options))


# --- the protocol -------------------------------------------------------------------------------------


def test_the_crc_is_the_one_of_the_catalogue() -> None:
    assert crc16(b"123456789") == 0x31C3  # CRC-16/XMODEM


@given(reading=READINGS)
def test_what_is_written_is_read(reading: Reading) -> None:
    assert parse_line(reading_line(reading).strip()) == reading
    assert parse_line(time_line(reading.time_us).strip()) == TimeTold(reading.time_us)


@given(reading=READINGS, data=st.data())
def test_no_flips_of_up_to_three_bits_pass(reading: Reading, data: st.DataObject) -> None:
    line = bytearray(reading_line(reading).strip())
    bits = data.draw(st.sets(st.integers(0, 8 * len(line) - 1), min_size=1, max_size=3))
    for bit in bits:
        line[bit // 8] ^= 1 << bit % 8
    assert parse_line(bytes(line)) is None


@given(readings=st.lists(READINGS, max_size=8), sizes=st.lists(st.integers(1, 60), max_size=20))
def test_lines_are_found_whatever_the_pieces(readings: list[Reading], sizes: list[int]) -> None:
    data, splitter, out = b"".join(reading_line(r) for r in readings), LineSplitter(), []
    for size in [*sizes, len(data)]:
        piece, data = data[:size], data[size:]
        out += [parse_line(line) for line in splitter.feed(piece)]
    assert out == readings


@given(noise=st.binary(max_size=500))
def test_noise_is_no_reading(noise: bytes) -> None:
    splitter = LineSplitter()
    assert all(parse_line(line) is None for line in splitter.feed(noise))


# --- a board that sends by itself ---------------------------------------------------------------------


def test_readings_are_stamped_by_the_board_s_clock() -> None:
    sensor, line = rig(board())
    for message in first(sensor.messages(until(line, 1e6)), 3000):
        at_s = message.stamp_ns * 1e-9 - 99.0
        if isinstance(message, WheelTicks):
            assert message.left == pytest.approx(TICKS_PER_S * at_s, abs=3.0)  # 2 ms
            assert message.left == -message.right
        else:
            assert isinstance(message, Imu) and message.yaw_rate_rad_s == 0.5 and message.yaw_rad is not None
            assert math.remainder(message.yaw_rad - 0.5 * at_s, 2 * math.pi) == pytest.approx(0.0, abs=2e-3)
    assert sensor.health.rate_hz == pytest.approx(100.0, rel=0.01)


def test_a_board_without_gyro_tells_of_wheels_alone() -> None:
    sensor, line = rig(board(with_gyro=False))
    assert {type(m) for m in first(sensor.messages(until(line, 1e6)), 50)} == {WheelTicks}


def test_the_board_s_drift_is_learned() -> None:
    sensor, line = rig(board(drift=-300e-6, with_gyro=False))
    last = [m for m in first(sensor.messages(until(line, 1e6)), 12_000) if isinstance(m, WheelTicks)][-1]
    assert last.left == pytest.approx(TICKS_PER_S * (last.stamp_ns * 1e-9 - 99.0), abs=4.0)  # else 36


def test_clock_and_counters_wrap_unnoticed() -> None:
    sensor, line = rig(board(time_us=(1 << 32) - 3_000_000, count_from=(1 << 31) - 5000, with_gyro=False))
    ticks = [m for m in first(sensor.messages(until(line, 1e6)), 800) if isinstance(m, WheelTicks)]
    assert set(np.diff([t.left for t in ticks])) <= {9, 10, 11}
    assert np.all(np.abs(np.diff([t.stamp_ns for t in ticks]) - 1e7) < 2e6)


def test_flipped_bits_cost_single_readings() -> None:
    sensor, line = rig(board(with_gyro=False), StreamingBoard, LineFaults(bit_flips=1e-4))
    ticks = [m for m in sensor.messages(until(line, 160.0)) if isinstance(m, WheelTicks)]
    whole = [b for b in line.wire.carried if b.intact]
    assert len(whole) - 2 <= len(ticks) < len(line.wire.carried)
    for t in ticks:
        assert t.left == pytest.approx(TICKS_PER_S * (t.stamp_ns * 1e-9 - 99.0), abs=4.0)


@pytest.mark.parametrize("fault", ["unplug", "power"])
def test_a_board_is_found_again(fault: Any) -> None:
    sensor, line = rig(board(), StreamingBoard, LineFaults(once=(LineFault(4.0, fault, 2.0),)))
    stamps = [m.stamp_ns for m in sensor.messages(until(line, 112.0)) if isinstance(m, WheelTicks)]
    assert stamps[-1] > 111.9e9 and np.all(np.diff(stamps) > 0) and sensor.health.reconnects == 1


def test_wheels_that_fall_silent_are_taken_up_again() -> None:
    sensor, line = rig(board(), StreamingBoard, LineFaults(once=(LineFault(4.0, "stall", 6.0),)))
    silent = False
    for message in sensor.messages(until(line, 116.0)):
        silent = silent or "no reading in 3 s" in sensor.health.text
        last = message
    assert sensor.health.reconnects == 1 and last.stamp_ns > 115.9e9


def test_a_silent_port_is_told() -> None:
    sensor, line = rig(board(), StreamingBoard, LineFaults(once=(LineFault(0.0, "stall", 1e9),)))
    with pytest.raises(SensorTrouble, match="board:line: no reading in 3 s"):
        first(sensor.messages(until(line, 1e6)), 1)


# --- the firmware of ros_arduino_bridge ---------------------------------------------------------------


def test_an_arduino_is_asked() -> None:
    sensor, line = rig(ArduinoDevice(Straight(), start_s=99.0), ArduinoBoard, None, "board.rate_hz=20")
    ticks = [m for m in first(sensor.messages(until(line, 1e6)), 60) if isinstance(m, WheelTicks)]
    for t in ticks:
        assert t.left == pytest.approx(TICKS_PER_S * (t.stamp_ns * 1e-9 - 99.0), abs=4.0)
    assert sensor.health.rate_hz == pytest.approx(20.0, rel=0.05)


def test_sides_are_swapped_where_the_wiring_is() -> None:
    sensor, line = rig(ArduinoDevice(Straight(), start_s=99.0), ArduinoBoard, None, "wheels.swap_sides=true")
    (message,) = first(sensor.messages(until(line, 1e6)), 1)
    assert isinstance(message, WheelTicks) and message.left < 0 < message.right


def test_counts_that_no_wheel_can_have_made_are_left_out() -> None:
    sensor, line = rig(ArduinoDevice(Straight(), start_s=99.0), ArduinoBoard, LineFaults(bit_flips=3e-4))
    ticks = [m for m in sensor.messages(until(line, 220.0)) if isinstance(m, WheelTicks)]
    assert sensor.health.errors["impossible-count"] > 0
    most = 10.0 / (2 * math.pi * 0.05) * 1024 * 0.3  # as fast as odometry.max_speed_m_s allows
    assert np.abs(np.diff([t.left for t in ticks])).max() < most and len(ticks) > 4000


def test_an_arduino_that_starts_anew_is_followed() -> None:
    faults = LineFaults(once=(LineFault(10.0, "power", 1.0),))
    sensor, line = rig(ArduinoDevice(Straight(), start_s=99.0), ArduinoBoard, faults)
    ticks = [m for m in sensor.messages(until(line, 120.0)) if isinstance(m, WheelTicks)]
    assert ticks[-1].stamp_ns > 119.9e9 and ticks[-1].left < 9000 < ticks[len(ticks) // 2].left + 5000


def test_something_else_on_the_port_is_told() -> None:
    sensor, line = rig(board(), ArduinoBoard)
    with pytest.raises(SensorTrouble, match="no encoder counts"):
        first(sensor.messages(until(line, 1e6)), 1)


def test_the_example_of_the_documentation() -> None:
    text = (Path(__file__).parents[2] / "docs" / "sensors.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"Example: `(.+?)`", text)
    assert parse_line(example.encode()) == Reading(1_000_000, 120, -3)
