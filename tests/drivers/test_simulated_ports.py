"""Simulated sensors in a process of their own, on pseudo-terminals at true bit rates: real bytes, real time."""

from __future__ import annotations

import json
import time
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from drivers.board.streaming import StreamingBoard
from drivers.scip.sensor import UrgSensor
from drivers.simulator.devices.serve import Cast, SimulatedSensors
from drivers.simulator.devices.wire import LineFault, LineFaults
from mfslam.settings import load
from mfslam.types import MfslamError, Scan, WheelTicks


def test_laser_and_board_share_a_world_and_a_cable_is_pulled(tmp_path: Path) -> None:
    """A serial line that starts at 19200 baud in SCIP 1.1 and is taken to 250000; the cable is out for a second."""
    record = tmp_path / "sent.jsonl"
    faults = LineFaults(once=(LineFault(4.0, "unplug", 1.0),))
    cast = Cast("demo", baud=19200, scip1=True, board="lines", laser_faults=faults, record=str(record))
    with SimulatedSensors(cast) as sim:
        laser = UrgSensor(str(sim.lidar), load(settings=["scip.baud=250000"]))
        wall_s = time.time() - time.monotonic()
        end_s = time.monotonic() + 9.0
        scans = [m for m in laser.messages(lambda: time.monotonic() > end_s) if isinstance(m, Scan)]
        wheels = list(islice(StreamingBoard(str(sim.board), load()).messages(lambda: False), 20))
    sent = [json.loads(line) for line in record.read_text(encoding="utf-8").splitlines()]
    blocks = {round(1e3 * (b["step_0_s"] + 0.1 * 44 / 1024)): b for b in sent if b["line"] == "lidar"}
    assert laser.health.reconnects == 1 and len(scans) > 25
    late = []
    for scan in scans:
        at = 1e3 * (scan.stamp_ns * 1e-9 - wall_s)
        nearest = min(blocks, key=lambda ms: abs(ms - at))
        values = np.array(blocks[nearest]["values"])
        np.testing.assert_allclose(scan.ranges_m[values >= 20], values[values >= 20] * 1e-3, atol=1e-6)
        late.append(at - nearest)
    assert abs(np.median(late)) < 5.0  # ms; a busy machine delays single ones
    # what was under way when the cable was pulled, or when we had enough, may not be read any more
    last_ms = 1e3 * (scans[-1].stamp_ns * 1e-9 - wall_s)
    whole = [ms for ms, b in blocks.items() if b["intact"] and ms < last_ms]
    gap = int(np.argmax(np.diff(whole)))
    assert sum(whole[gap] - 1000.0 < ms <= whole[gap] for ms in whole) >= len(whole) - len(scans)
    assert any(isinstance(m, WheelTicks) for m in wheels)


def test_a_world_that_is_not_there_is_told() -> None:
    with pytest.raises(MfslamError, match="no world"):
        SimulatedSensors(Cast("nowhere"))
