"""The drives and faults of scripts/robustness.py."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from robustness_worlds import (
    at_rate,
    crowded_office,
    delayed,
    glass_aisle,
    identical_offices,
    mount_misread,
    race_track,
    sparse_yard,
    swinging_doors,
    symmetric_ring,
)

from drivers.simulator import Faults, LaserModel, RobotModel, World, laser_model, load_world, random_office
from drivers.simulator.demo import demo_robot
from drivers.simulator.sensors import laser_preset

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
        "10 % too long, 5 % yaw, slip": replace_robot(
            radius_error_left=-0.1, radius_error_right=-0.1, track_error=0.05, slip_m_per_sqrt_m=0.03
        ),
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
    racer = replace_robot(lateral_acceleration_m_s2=6.0, acceleration_m_s2=4.0)
    good_wheels = replace_robot(radius_error_left=0.0, radius_error_right=0.0, track_error=0.0)
    return [
        Case("bare corridor of 60 m", None, partial(load_world, "corridor"), fast, good_wheels),
        Case("bare corridor of 60 m, urg-04lx", "bare corridor of 60 m", partial(load_world, "corridor"), urg,
             good_wheels, preset="urg-04lx"),
        Case("office, 8 people walk", "office", partial(crowded_office, 8), fast),
        Case("office, 8 people walk, no odometry", "office", partial(crowded_office, 8), fast, no_wheels),
        Case("square-aisle, inner wall of glass", "square-aisle", glass_aisle, fast),
        Case("race-track, 3 m/s and 2 rad/s", None, race_track, fast, racer),
        Case("race-track, 3 m/s and 2 rad/s, no odometry", "race-track, 3 m/s and 2 rad/s", race_track, fast,
             dataclasses.replace(racer, odometry="none")),
        Case("race-track, 3 m/s and 2 rad/s, urg-04lx", "race-track, 3 m/s and 2 rad/s", race_track, urg, racer,
             preset="urg-04lx"),
        Case("sparse yard", None, sparse_yard, fast),
        Case("sparse yard, urg-04lx", "sparse yard", sparse_yard, urg, preset="urg-04lx"),
        Case("sparse yard, no odometry", "sparse yard", sparse_yard, fast, no_wheels),
        Case("office, doors swing", "office", swinging_doors, fast),
        Case("office, doors swing, no odometry", "office", swinging_doors, fast, no_wheels),
        Case("square-aisle, urg-04lx, no odometry", "square-aisle", partial(load_world, "square-aisle"), urg,
             no_wheels, preset="urg-04lx"),
        Case("h-aisle, no odometry", "h-aisle", partial(load_world, "h-aisle"), fast, no_wheels),
        Case("hall, no odometry", "hall", partial(load_world, "hall"), fast, no_wheels),
    ]  # fmt: skip


def look_alike_cases() -> list[Case]:
    """Places that look like others."""
    long_wheels = replace_robot(radius_error_left=-0.1, radius_error_right=-0.1)
    robots = {
        "": demo_robot(),
        ", 10 % too long": long_wheels,
        ", no odometry": replace_robot(odometry="none"),
    }
    sensors = {
        "": "fast",
        ", urg-04lx": "urg-04lx",
        ", sick-lms200": "sick-lms200",
        ", rplidar-a1": "rplidar-a1",
    }
    # not in order: some rooms again after many others, some passed by before they are gone into
    out_of_order = (0, 3, 1, 8, 5, 2, 5, 11, 9, 0)
    worlds: dict[str, Callable[[], World]] = {
        "identical offices": identical_offices,
        "identical offices out of order": partial(identical_offices, 12, out_of_order),
        "symmetric ring": symmetric_ring,
    }
    out = []
    for name, world in worlds.items():
        for sensor, model in sensors.items():
            preset = laser_preset(model)
            out += [
                Case(f"{name}{sensor}{wheels}", None if sensor + wheels == "" else name, world,
                     partial(laser_model, model, (0.1, 0.0, 0.0)), robot, preset=preset)
                for wheels, robot in robots.items()
                if not wheels or model in ("fast", "urg-04lx")
            ]  # fmt: skip
    return out


def all_cases() -> list[Case]:
    return [
        *sensor_cases(), *wheel_cases(), *laser_cases(), *clock_cases(), *world_cases(), *look_alike_cases()
    ]  # fmt: skip
