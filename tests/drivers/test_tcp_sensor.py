"""A Hokuyo over TCP: a simulated one behind a real socket, whose connection breaks once."""

from __future__ import annotations

import contextlib
import socket
import threading
import time

import numpy as np
import pytest
from virtual_line import Room

from drivers.scip.sensor import UrgSensor
from drivers.simulator.devices.urg import SimulatedUrg
from drivers.simulator.devices.wire import Wire
from drivers.transport import Unplugged, open_transport, tcp_address
from mfslam.config import Config
from mfslam.types import MfslamError, Scan


class Server(threading.Thread):
    """One connection after the other; the first is closed after ``first_s``."""

    def __init__(self, first_s: float) -> None:
        super().__init__(daemon=True)
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.port = self.listener.getsockname()[1]
        self.first_s = first_s
        self.done = threading.Event()

    def run(self) -> None:
        wire = Wire(SimulatedUrg(Room("utm-30lx"), start_s=time.monotonic()), paced=False)
        patience_s = self.first_s
        while not self.done.is_set():
            connection, _ = self.listener.accept()
            connection.setblocking(False)
            until_s = time.monotonic() + patience_s
            try:
                while time.monotonic() < until_s and not self.done.is_set():
                    self.exchange(connection, wire)
                    time.sleep(0.001)
            except OSError:
                pass
            connection.close()
            patience_s = 1e9

    def exchange(self, connection: socket.socket, wire: Wire) -> None:
        with contextlib.suppress(BlockingIOError):
            wire.to_device(connection.recv(4096), time.monotonic())
        data = wire.to_host(time.monotonic())
        if data:
            connection.sendall(data)


def test_scans_come_over_tcp_and_again_after_the_connection_broke() -> None:
    server = Server(first_s=1.5)
    server.start()
    sensor = UrgSensor(f"127.0.0.1:{server.port}", Config())
    scans: list[Scan] = []
    for message in sensor.messages(lambda: sensor.health.reconnects == 1 and len(scans) > 80):
        assert isinstance(message, Scan)
        scans.append(message)
    server.done.set()
    laser = scans[0].laser
    assert laser.angles_rad.size == 1081 and laser.range_max_m == pytest.approx(60.0)
    assert np.degrees(laser.angles_rad[[0, -1]]) == pytest.approx([-135.0, 135.0])
    assert np.all(np.diff([s.stamp_ns for s in scans]) > 0)
    assert np.median(np.diff([s.stamp_ns for s in scans])) == pytest.approx(25e6, abs=2e6)


def test_addresses() -> None:
    assert tcp_address("192.168.0.10:10940") == ("192.168.0.10", 10940)
    assert tcp_address("[::1]:10940") == ("::1", 10940)
    assert tcp_address("/dev/serial/by-id/usb-Hokuyo:1") is None and tcp_address("/dev/ttyACM0") is None
    with pytest.raises(MfslamError, match="host:port"):
        tcp_address("urg.local:http")
    with pytest.raises(Unplugged, match="cannot be reached"):
        open_transport("127.0.0.1:1", 0)
