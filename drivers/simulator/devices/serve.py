"""Simulated sensors as a process of their own: ``python -m drivers.simulator.devices.serve`` (by `start`).

The process reads what it is to be from its first line of input (JSON), says where its ports are, and ends
when its input is closed: with whoever started it.
"""

from __future__ import annotations

import json
import os
import select
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from types import TracebackType
from typing import IO, Literal, Self

from pydantic import TypeAdapter

from drivers.own_process import command, environment
from drivers.simulator.devices.wire import Device, LineFaults, Wire
from mfslam.types import MfslamError

START_S = 60.0  # patience with a machine that imports slowly
STEP_S = 0.001


@dataclass(frozen=True)
class Cast:
    """What is simulated. ``laser``: a model of `stage.URG_MODELS` or `RPLIDAR_MODELS`; ``baud``: of its serial line, None for USB.
    ``record``: file for a line of JSON per block that was sent, for tests."""

    world: str = "demo"
    laser: str | None = "urg-04lx"
    board: Literal["arduino", "lines"] | None = None
    baud: int | None = None
    scip1: bool = False
    mount: tuple[float, float, float] = (0.1, 0.0, 0.0)
    speed_m_s: float = 1.0
    gyro: bool = True
    seed: int = 0
    laser_faults: LineFaults = field(default_factory=LineFaults)
    board_faults: LineFaults = field(default_factory=LineFaults)
    record: str | None = None


_CAST = TypeAdapter(Cast)


class SimulatedSensors:
    """The process that plays the sensors; a context manager. ``lidar`` and ``board`` are paths of ports."""

    def __init__(self, cast: Cast) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="mfslam-sim-")
        self.folder = Path(self._folder.name)
        self.process = subprocess.Popen(
            command("drivers.simulator.devices.serve", str(self.folder)),
            env=environment(),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,  # Ctrl-C is for whoever started it
        )
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps(asdict(cast)) + "\n")
        self.process.stdin.flush()
        said = self._said()
        if said != "ready":
            self.close()
            raise MfslamError(f"the simulated sensors do not start: {said or 'they ended at once'}")
        self.lidar, self.board = self.folder / "lidar", self.folder / "board"

    def _said(self) -> str:
        out = self.process.stdout
        assert out is not None
        ready, _, _ = select.select([out], [], [], START_S)
        return out.readline().strip() if ready else "no word in time"

    def close(self) -> None:
        assert self.process.stdin is not None and self.process.stdout is not None
        self.process.stdin.close()
        try:
            self.process.wait(5.0)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self.process.stdout.close()
        self._folder.cleanup()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def main(folder: Path) -> int:
    try:
        lines = _lines(_CAST.validate_python(json.loads(sys.stdin.readline())), folder)
    except (MfslamError, ValueError) as error:
        print(" ".join(str(error).split()), flush=True)
        return 1
    print("ready", flush=True)
    _play(*lines)
    return 0


def _lines(cast: Cast, folder: Path) -> tuple[list[_Line], IO[str] | None]:
    import numpy as np

    from drivers.rplidar.sensor import MODELS
    from drivers.simulator.catalog import load_world
    from drivers.simulator.devices.board import ArduinoDevice, StreamingBoardDevice
    from drivers.simulator.devices.rplidar import SimulatedRplidar
    from drivers.simulator.devices.stage import RPLIDAR_MODELS, URG_MODELS, Stage
    from drivers.simulator.devices.urg import SimulatedUrg
    from drivers.simulator.robot import RobotModel
    from mfslam.settings import did_you_mean

    models = URG_MODELS | RPLIDAR_MODELS
    if cast.laser is not None and cast.laser not in models:
        hint = did_you_mean(cast.laser, models) or "."
        raise MfslamError(f"no simulated laser {cast.laser!r}{hint} Known: {', '.join(models)}")
    robot = RobotModel(max_speed_m_s=cast.speed_m_s)
    world = load_world(cast.world, cast.speed_m_s)
    stage = Stage(world, robot, models[cast.laser or "urg-04lx"], np.array(cast.mount), seed=cast.seed)
    stage.values(0.0)  # compiles the ray caster
    start_s = time.monotonic() + 0.2
    out: list[_Line] = []
    if cast.laser in RPLIDAR_MODELS:
        model = cast.laser.removeprefix("rplidar-")
        rplidar = SimulatedRplidar(stage, model, cast.baud or MODELS[model.upper()].bauds[0], start_s)
        out.append(_Line("lidar", rplidar, cast.laser_faults, folder, True))
    elif cast.laser is not None:
        urg = SimulatedUrg(stage, cast.baud or 115200, cast.scip1, 4e6, 30e-6, start_s)
        out.append(_Line("lidar", urg, cast.laser_faults, folder, cast.baud is not None))
    if cast.board == "arduino":
        out.append(_Line("board", ArduinoDevice(stage, start_s=start_s), cast.board_faults, folder, True))
    elif cast.board == "lines":
        board = StreamingBoardDevice(stage, drift=-40e-6, start_s=start_s, with_gyro=cast.gyro)
        out.append(_Line("board", board, cast.board_faults, folder, True))
    return out, None if cast.record is None else Path(cast.record).open("w", encoding="utf-8")


class _Line:
    """A device at its port."""

    def __init__(self, name: str, device: Device, faults: LineFaults, folder: Path, paced: bool) -> None:
        from drivers.simulator.devices.pty_port import PtyPort

        self.name = name
        self.wire = Wire(device, faults, paced=paced)
        self.port = PtyPort(folder / name)
        self._pending = b""
        self._is_wanted = False  # the line's time begins with the host's first word

    def step(self, now_s: float) -> None:
        away = now_s < self.wire.unplugged_until_s
        if away and self.port.plugged_in:
            self.port.unplug()
            self._pending = b""
        elif not away and not self.port.plugged_in:
            self.port.plug_in()
        baud = self.port.host_baud() if self.port.plugged_in else None
        if self.port.plugged_in and (data := self.port.read()):
            self._is_wanted = True
            self.wire.to_device(data, now_s, baud)
        if not self._is_wanted:
            return
        if self._pending:  # a host that does not read holds the device up
            self._pending = self.port.write(self._pending)
        else:
            self._pending = self.wire.to_host(now_s, baud)
            if self._pending and self.port.plugged_in:
                self._pending = self.port.write(self._pending)

    def told(self) -> list[str]:
        carried, self.wire.carried = self.wire.carried, []
        return [json.dumps({"line": self.name, "intact": b.intact, **(b.record or {})}) for b in carried]


def _play(lines: list[_Line], record: IO[str] | None) -> None:
    """Until nobody holds the other end of our input."""
    stdin = sys.stdin.fileno()
    while True:
        watched = [line.port for line in lines if line.port.plugged_in]
        ready, _, _ = select.select([stdin, *watched], [], [], STEP_S)
        if stdin in ready and not os.read(stdin, 4096):
            break
        for line in lines:
            line.step(time.monotonic())
            if record is not None:
                record.writelines(text + "\n" for text in line.told())
        if record is not None:
            record.flush()
        elif lines:
            for line in lines:
                line.wire.carried.clear()
    for line in lines:
        if line.port.plugged_in:
            line.port.unplug()


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
