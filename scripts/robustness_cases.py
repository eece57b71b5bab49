"""The drives and faults of scripts/robustness.py."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import drivers.simulator.world
from drivers.simulator import (
    Faults,
    LaserModel,
    RobotModel,
    World,
    laser_model,
    load_world,
    parse_world,
    random_office,
)
from drivers.simulator.demo import demo_robot
from drivers.simulator.offices import random_office_text

# --- worlds and sensors --------------------------------------------------------------------------------


def shipped_text(name: str) -> str:
    return (Path(drivers.simulator.world.__file__).parent / "worlds" / f"{name}.world").read_text(
        encoding="utf-8"
    )


def glass_aisle() -> World:
    """The square aisle, its inner wall all of glass."""
    return parse_world(shipped_text("square-aisle").replace("wall 2.4 2.4", "glass 2.4 2.4"), "glass-aisle")


def crowded_office(people: int) -> World:
    return parse_world(random_office_text(7, people=people), f"office with {people} people")


def identical_offices(rooms: int = 8) -> World:
    """A corridor with the same room again and again on both sides: nothing but counting tells them apart."""
    width, depth, half = 5.0, 4.5, 1.1
    lines = [f"wall 0 {-half} 0 {half}", f"wall {rooms * width} {-half} {rooms * width} {half}"]
    path = ["path 1 0 1"]
    for k in range(rooms):
        x = k * width
        for side in (1, -1):
            near, far = side * half, side * (half + depth)
            lines += [
                f"wall {x} {near} {x} {far} {x + width} {far} {x + width} {near}",
                f"wall {x} {near} {x + 1.9} {near}",
                f"wall {x + 3.1} {near} {x + width} {near}",
                f"box {x + 1.0} {far - side * 0.5} 1.4 0.8",
            ]
        path += [f"path {x + dx} {y}" for dx, y in ((2.5, 0), (2.5, 3.2), (2.5, 0), (2.5, -3.2), (2.5, 0))]
    back = [f"path {rooms * width - 2} 0", "path 22.5 0", "path 22.5 3.2", "path 22.5 0", "path 1 0"]
    return parse_world("\n".join([*lines, *path, *back]), "identical-offices")


def at_rate(model: LaserModel, rate_hz: float) -> LaserModel:
    """The same laser turning slower or faster."""
    stretch = 1.0 / (rate_hz * model.period_s)
    laser = dataclasses.replace(model.laser, offsets_s=model.laser.offsets_s * stretch)
    return dataclasses.replace(model, laser=laser, period_s=1.0 / rate_hz)


def mount_misread(model: LaserModel, degrees: float) -> LaserModel:
    told = model.laser.body_T_laser + np.array([0.0, 0.0, np.radians(degrees)])
    return dataclasses.replace(model, reported=dataclasses.replace(model.laser, body_T_laser=told))


def delayed(model: LaserModel, delay_s: float, known: bool) -> LaserModel:
    """Stamps late by ``delay_s``; ``known``: the sensor's transport delay is set accordingly."""
    told = dataclasses.replace(model.laser, offsets_s=model.laser.offsets_s - delay_s) if known else None
    return dataclasses.replace(model, stamp_delay_s=delay_s, reported=told)


# --- cases ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Case:
    """One drive and one fault. ``reference``: the case that it is the spoilt version of."""

    name: str
    reference: str | None
    world: Callable[[], World]
    laser: Callable[[], LaserModel]
    robot: RobotModel = field(default_factory=demo_robot)
    preset: str = "generic"
    faults: Faults = field(default_factory=Faults)
    odometry_in_scans: bool = False
    settings: tuple[str, ...] = ()
    seed: int = 1


def fast(mount: tuple[float, float, float] = (0.1, 0.0, 0.0)) -> LaserModel:
    return laser_model("fast", mount)


def every(start_s: float, stop_s: float, step_s: float, length_s: float) -> tuple[tuple[float, float], ...]:
    return tuple((float(t), float(t + length_s)) for t in np.arange(start_s, stop_s, step_s))


def sensor_cases() -> list[Case]:
    """Every world with the demo's sensor, and every sensor in a few worlds."""
    worlds = {
        name: partial(load_world, name) for name in ("demo", "office", "square-aisle", "h-aisle", "hall")
    }
    worlds |= {f"random office {seed}": partial(random_office, seed) for seed in (1, 2, 3)}
    out = [Case(name, None, world, fast) for name, world in worlds.items()]
    for sensor in ("urg-04lx", "rplidar-a1", "sick-lms200", "utm-30lx"):
        model = partial(laser_model, sensor, (0.1, 0.0, 0.0))
        for name in ("demo", "office", "square-aisle", "h-aisle"):
            if sensor == "utm-30lx" and name == "office":
                continue  # forty scans a second for three minutes: the others say the same sooner
            out.append(Case(f"{name}, {sensor}", name, worlds[name], model, preset=sensor))
    a1 = partial(laser_model, "rplidar-a1")
    out.append(
        Case(
            "demo, rplidar-a1 at 10 Hz",
            "demo",
            worlds["demo"],
            lambda: at_rate(a1(), 10.0),
            preset="rplidar-a1",
        )
    )
    return out


def wheel_cases() -> list[Case]:
    """What wheels do to a log."""
    robot, ticks = demo_robot(), replace_robot(odometry="ticks")
    true_wheels = tuple(f"wheels.{key}={value}" for key, value in robot.wheels.model_dump().items() if value)
    wheels: dict[str, RobotModel] = {
        "no odometry": replace_robot(odometry="none"),
        "10 % too long": replace_robot(radius_error_left=-0.1, radius_error_right=-0.1),
        "5 % too much yaw": replace_robot(track_error=0.05, radius_error_left=0.0, radius_error_right=0.0),
        "2 deg/m yaw drift": replace_robot(radius_error_left=0.0, radius_error_right=0.012),
        "slip 5 cm per root m": replace_robot(slip_m_per_sqrt_m=0.05),
    }
    jumps = ((21.3, 0.9, 0.0, 0.0), (33.7, 0.0, 0.0, 1.5), (44.1, -0.6, 0.6, -1.5), (52.9, 0.2, -0.9, 0.4))
    out = []
    for world in ("demo", "office", "square-aisle"):
        make = partial(load_world, world)
        out += [Case(f"{world}, {name}", world, make, fast, spoilt) for name, spoilt in wheels.items()]
        out += [
            Case(f"{world}, odometry jumps", world, make, fast, robot, faults=Faults(odometry_jumps=jumps)),
            Case(f"{world}, odometry jumps, poses in scans", world, make, fast, robot,
                 faults=Faults(odometry_jumps=jumps), odometry_in_scans=True),
            Case(f"{world}, odometry jumps, read at scans only", world, make, fast,
                 replace_robot(encoder_rate_hz=None), faults=Faults(odometry_jumps=jumps), odometry_in_scans=True),
            Case(f"{world}, encoder ticks", world, make, fast, ticks, settings=true_wheels),
            Case(f"{world}, encoder ticks, wheels 37 % too small", world, make, fast, ticks),
            Case(f"{world}, odometry gaps of 3 s", world, make, fast, robot,
                 faults=Faults(odometry_gaps_s=every(5.0, 200.0, 12.0, 3.0))),
        ]  # fmt: skip
    return out


def replace_robot(**changes: Any) -> RobotModel:
    return dataclasses.replace(demo_robot(), **changes)


def laser_cases() -> list[Case]:
    """What the laser does to a log."""
    gaps = Faults(scan_gaps_s=((10.0, 10.5), (20.0, 21.0), (31.0, 33.0), (47.0, 48.5)))
    out = []
    for world in ("demo", "office", "square-aisle"):
        make = partial(load_world, world)
        out += [
            Case(f"{world}, scans missing for up to 2 s", world, make, fast, faults=gaps),
            Case(f"{world}, scans missing for up to 2 s, no odometry", world, make, fast,
                 replace_robot(odometry="none"), faults=gaps),
            Case(f"{world}, every other scan lost", world, make, fast, faults=Faults(drop_share=0.5)),
            Case(f"{world}, 5 Hz laser", world, make, lambda: at_rate(fast(), 5.0)),
            Case(f"{world}, laser's mount 3 deg wrong", world, make, lambda: mount_misread(fast(), 3.0)),
            Case(f"{world}, stamps 50 ms late", world, make, lambda: delayed(fast(), 0.05, False)),
            Case(f"{world}, stamps 150 ms late, and told", world, make, lambda: delayed(fast(), 0.15, True)),
            Case(f"{world}, a fifth of the beams lost", world, make,
                 lambda: dataclasses.replace(fast(), error_share=0.2)),
        ]  # fmt: skip
    return out


def clock_cases() -> list[Case]:
    """What clocks do to a log, and logs that begin anew in the middle."""
    robots = {"": demo_robot(), ", no odometry": replace_robot(odometry="none"),
              ", gyro": replace_robot(gyro_rate_hz=100.0)}  # fmt: skip
    faults = {
        "scans in bursts of 4": Faults(burst_scans=4),
        "scans in bursts of 10": Faults(burst_scans=10),
        "restart, odometry at zero": Faults(restarts=((33.0, 0.0, 0.0),)),
        "restart, clock +100 s": Faults(restarts=((33.0, 0.0, 100.0),)),
        "restart, clock -3 s": Faults(restarts=((33.0, 0.0, -3.0),)),
        "restart, clock -0.5 s": Faults(restarts=((33.0, 0.0, -0.5),)),
        "restarts, clock +100 s and back": Faults(restarts=((33.0, 0.0, 100.0), (50.0, 0.0, -100.0))),
    }
    ticks, wheels = replace_robot(odometry="ticks"), demo_robot().wheels.model_dump()
    true_wheels = tuple(f"wheels.{key}={value}" for key, value in wheels.items() if value)
    out = []
    for world in ("demo", "office"):
        make = partial(load_world, world)
        out += [
            Case(f"{world}, {fault}{sources}", world, make, fast, robot, faults=spoilt)
            for fault, spoilt in faults.items()
            for sources, robot in robots.items()
            if not sources or (world == "demo" and spoilt.restarts[:1] != ((33.0, 0.0, 0.0),))
        ]
        out += [
            Case(f"{world}, restart, clock +100 s, counters at zero", world, make, fast, ticks,
                 faults=faults["restart, clock +100 s"], settings=true_wheels),
            Case(f"{world}, restart after 2 s of silence", world, make, fast,
                 faults=Faults(restarts=((33.0, 2.0, 0.0),))),
        ]  # fmt: skip
    return out


def world_cases() -> list[Case]:
    """What the world does to a log."""
    urg = partial(laser_model, "urg-04lx", (0.1, 0.0, 0.0))
    no_wheels = replace_robot(odometry="none")
    good_wheels = replace_robot(radius_error_left=0.0, radius_error_right=0.0, track_error=0.0)
    return [
        Case("bare corridor of 60 m", None, partial(load_world, "corridor"), fast, good_wheels),
        Case("bare corridor of 60 m, urg-04lx", "bare corridor of 60 m", partial(load_world, "corridor"), urg,
             good_wheels, preset="urg-04lx"),
        Case("office, 8 people walk", "office", partial(crowded_office, 8), fast),
        Case("office, 8 people walk, no odometry", "office", partial(crowded_office, 8), fast, no_wheels),
        Case("square-aisle, inner wall of glass", "square-aisle", glass_aisle, fast),
        Case("identical offices", None, identical_offices, fast),
        Case("identical offices, 10 % too long", "identical offices", identical_offices, fast,
             replace_robot(radius_error_left=-0.1, radius_error_right=-0.1)),
        Case("identical offices, no odometry", "identical offices", identical_offices, fast, no_wheels),
        Case("identical offices, urg-04lx", "identical offices", identical_offices, urg, preset="urg-04lx"),
        Case("square-aisle, urg-04lx, no odometry", "square-aisle", partial(load_world, "square-aisle"), urg,
             no_wheels, preset="urg-04lx"),
        Case("h-aisle, no odometry", "h-aisle", partial(load_world, "h-aisle"), fast, no_wheels),
        Case("hall, no odometry", "hall", partial(load_world, "hall"), fast, no_wheels),
    ]  # fmt: skip


def all_cases() -> list[Case]:
    return [*sensor_cases(), *wheel_cases(), *laser_cases(), *clock_cases(), *world_cases()]
