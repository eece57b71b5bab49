"""The page: claims against figures, the settings, then every section."""

from __future__ import annotations

import datetime
import os
import platform
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import mfslam
from paper.rig import MOUNT, RANGE_MAX_M, WHEELS, paper_laser, paper_robot

_FIGURE = re.compile(r"\]\(([\w-]+\.(?:png|svg))\)")

INTRODUCTION = """# The paper, reproduced

mfslam came from Hwang and Lee, *Robust 2D map building with motion-free ICP algorithm for mobile robot navigation*. Its
two experiments run here from its equations, on a simulator that knows the truth at every beam: the paper's
robot, its laser, aisles of its shapes. Everything below is measured and written by one command; seeds are fixed, only timings vary.

```sh
scripts/reproduce_paper.py                    # this page, its figures and their numbers
scripts/reproduce_paper.py --only aisles      # one section again
```
"""

CLAIMS = """## Claims and figures

What the paper says (or the bar that this project set itself), what was measured, and whether it holds."""


def page_text(sections: Mapping[str, Mapping[str, Any]], figures: str) -> str:
    """The page of all sections, by name, as `Section` plus seconds; ``figures``: their folder from the page."""
    parts = [INTRODUCTION + _measured_line(sections), CLAIMS, _claims_table(sections), _settings()]
    for section in sections.values():
        body = _FIGURE.sub(rf"]({figures}/\1)", section["body"])
        parts.append(f"## {section['title']}\n\n{body}")
    return "\n\n".join(part.strip("\n") for part in parts) + "\n"


def _measured_line(sections: Mapping[str, Mapping[str, Any]]) -> str:
    took = sum(section["seconds"] for section in sections.values())
    quick = " **Short version: coarser sampling.**" if any(s["quick"] for s in sections.values()) else ""
    return (
        f"\nMeasured on {datetime.date.today().isoformat()}, {machine()}, mfslam {mfslam.__version__}, "
        f"in {took / 60.0:.1f} minutes.{quick}"
    )


def machine() -> str:
    model = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.is_file():
        named = re.search(r"^model name\s*:\s*(.+)$", cpuinfo.read_text(), re.MULTILINE)
        model = named[1] if named else model
    return f"{model}, {os.cpu_count()} cores, {platform.system()}, Python {platform.python_version()}"


def _claims_table(sections: Mapping[str, Mapping[str, Any]]) -> str:
    lines = ["| claim | measured | holds | why |", "| --- | --- | --- | --- |"]
    lines += [
        f"| {claim['paper']} | {claim['ours']} | {'yes' if claim['holds'] else '**no**'} | {claim['why']} |"
        for section in sections.values()
        for claim in section["claims"]
    ]
    return "\n".join(lines)


def _settings() -> str:
    robot, model = paper_robot(), paper_laser()
    laser = model.laser
    return f"""## Settings

The paper gives no dimensions; these are ours.

| what | setting |
| --- | --- |
| square aisle | `drivers/simulator/worlds/square-aisle.world`: 24 m a side, 2.4 m wide, niches, pillars; sides driven at 1, 2, 3 and 1 m/s after a rest |
| H aisle | `h-aisle.world`: two aisles of 26 m joined by a bar of 18 m, 2.4 m wide; 1 m/s, turn right, 3 m/s, 1 m/s, and home the same way |
| robot | differential drive, tracks {WHEELS.track_m:g} m apart, wheels of {1e3 * WHEELS.radius_left_m:g} mm, {WHEELS.ticks_per_turn:g} pulses a turn read at {robot.encoder_rate_hz:g} Hz |
| wrong with it | radii (left, right; in every other log the other way round) {100 * robot.radius_error_left:+.1f} and {100 * robot.radius_error_right:+.1f} %, track {100 * robot.track_error:+.0f} %, slip {1e3 * robot.slip_m_per_sqrt_m:g} mm per root metre and wheel: not told to the engine |
| limits | {robot.acceleration_m_s2:g} m/s², {robot.max_yaw_rate_rad_s:g} rad/s |
| laser | URG-04LX: {len(laser.angles_rad)} beams over 240 deg, {1e3 * float(laser.offsets_s.max()):.1f} ms of a turn of {1e3 * model.period_s:g} ms, {RANGE_MAX_M:g} m, noise {100 * laser.range_sigma_m:g} cm (one sigma), steps of 1 mm, {MOUNT[0]:g} m ahead of the axle |
| gyro, compass | none: the wheels are enough to show the point |"""
