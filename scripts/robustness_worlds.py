"""The worlds and spoilt sensors of scripts/robustness.py."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

import drivers.simulator.world
from drivers.simulator import LaserModel, World, parse_world
from drivers.simulator.offices import random_office_text

# --- worlds ------------------------------------------------------------------------------------------------


def shipped_text(name: str) -> str:
    return (Path(drivers.simulator.world.__file__).parent / "worlds" / f"{name}.world").read_text(
        encoding="utf-8"
    )


def glass_aisle() -> World:
    """The square aisle, its inner wall all of glass."""
    return parse_world(shipped_text("square-aisle").replace("wall 2.4 2.4", "glass 2.4 2.4"), "glass-aisle")


def crowded_office(people: int) -> World:
    return parse_world(random_office_text(7, people=people), f"office with {people} people")


def identical_offices(rooms: int = 8, visited: Iterable[int] | None = None) -> World:
    """A corridor with the same room again and again on both sides: nothing but counting tells them apart.

    ``visited``: rooms gone into, in this order; all of them one after the other, and one again, where not given.
    """
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
    for k in range(rooms) if visited is None else visited:
        x = k * width
        path += [f"path {x + dx} {y}" for dx, y in ((2.5, 0), (2.5, 3.2), (2.5, 0), (2.5, -3.2), (2.5, 0))]
    back = [f"path {rooms * width - 2} 0", "path 22.5 0", "path 22.5 3.2", "path 22.5 0", "path 1 0"]
    return parse_world("\n".join([*lines, *path, *back]), "identical-offices")


def symmetric_ring(side_m: float = 20.0, laps: int = 2) -> World:
    """A corridor of 2 m around a square, its four sides the same: a quarter of a lap looks like a whole one."""
    half, width = 0.5 * side_m, 2.0
    outer, inner = [], []
    for quarter in range(4):
        turn = 0.5 * math.pi * quarter
        c, s = math.cos(turn), math.sin(turn)

        def at(x: float, y: float, c: float = c, s: float = s) -> str:
            return f"{c * x - s * y:.4f} {s * x + c * y:.4f}"

        for x in (-0.5 * half, 0.1 * half, 0.6 * half):  # niches 1.2 m wide in the outer wall
            outer += [at(x, -half), at(x, -half - 0.4), at(x + 1.2, -half - 0.4), at(x + 1.2, -half)]
        outer.append(at(half, -half))
        near = half - width
        inner += [at(-0.2 * half, -near), at(-0.2 * half, -near + 0.4)]
        inner += [at(-0.2 * half + 1.0, -near + 0.4), at(-0.2 * half + 1.0, -near), at(near, -near)]
    walls = [f"wall {' '.join([*points, points[0]])}" for points in (outer, inner)]
    middle = half - 0.5 * width
    corners = [(middle, -middle), (middle, middle), (-middle, middle), (-middle, -middle)]
    path = [f"path {-0.3 * half} {-middle} 1"]
    path += [f"path {x} {y}" for _ in range(laps) for x, y in corners]
    return parse_world("\n".join([*walls, *path, f"path {0.5 * half} {-middle}"]), "symmetric-ring")


def sparse_yard(seed: int = 1, pitch_m: float = 4.0) -> World:
    """A yard of 40 m by 28 m without walls in it, thin posts about every ``pitch_m``: few beams meet anything."""
    rng = np.random.default_rng(seed)
    posts = []
    for x in np.arange(-20.0, 20.1, pitch_m):
        for y in np.arange(-14.0, 14.1, pitch_m):
            dx, dy = rng.uniform(-0.35, 0.35, 2) * pitch_m
            posts.append((float(x + dx), float(y + dy), float(rng.uniform(0.06, 0.2))))
    way = [(-14, -9), (14, -9), (14, 9), (-14, 9), (-14, -9), (0, -9), (0, 9), (-14, 9), (-14, -5)]
    clear = _clear_of(way, posts, 0.8)
    lines = [
        "wall -26 -20 26 -20 26 20 -26 20 -26 -20",
        *(f"pillar {x:.3f} {y:.3f} {r:.3f}" for x, y, r in clear),
    ]
    return parse_world("\n".join([*lines, *(f"path {x} {y} 1.5" for x, y in way)]), "sparse-yard")


def _clear_of(
    way: Sequence[tuple[float, float]], posts: list[tuple[float, float, float]], room_m: float
) -> list[tuple[float, float, float]]:
    """The posts that leave the robot its way."""
    corners = np.array(way, dtype=float)
    starts, steps = corners[:-1], np.diff(corners, axis=0)
    kept = []
    for post in posts:
        away = np.array(post[:2]) - starts
        share = np.clip((away * steps).sum(axis=1) / (steps**2).sum(axis=1), 0.0, 1.0)
        if np.hypot(*(away - share[:, None] * steps).T).min() > room_m:
            kept.append(post)
    return kept


def swinging_doors(seed: int = 7, period_s: float = 12.0) -> World:
    """A random office whose doors all swing open and shut again and again."""
    lines = []
    for k, line in enumerate(random_office_text(seed).splitlines()):
        words = line.split()
        if words[:1] == ["door"]:
            words[-1] = f"{period_s + 0.7 * (k % 5):g}"
        lines.append(" ".join(words))
    return parse_world("\n".join(lines), "office with swinging doors")


def race_track() -> World:
    """A hall of 24 m by 16 m with boxes, driven in slaloms: as fast as the robot drives and turns."""
    boxes = [f"box {x} {y} {w} {d} {a}" for x, y, w, d, a in (
        (6, 8, 1.2, 0.8, 10), (12, 8, 0.8, 1.4, 30), (18, 8, 1.0, 1.0, 0), (2, 15, 2.4, 0.8, 0),
        (22.5, 14, 1.2, 1.8, 0), (21, 1, 2.0, 0.9, 0), (1, 3, 0.8, 2.2, 0), (11, 15.4, 3.0, 0.7, 0),
    )]  # fmt: skip
    way = [(3, 5), (6, 5), (9, 8), (12, 11), (15, 8), (18, 5), (21, 8), (18, 11), (15, 8), (12, 5), (9, 8),
           (6, 11), (3, 8)]  # fmt: skip
    path = [f"path {x} {y} 3" for _ in range(3) for x, y in way]
    return parse_world(
        "\n".join(["wall 0 0 24 0 24 16 0 16 0 0", *boxes, *path, "path 3 5", "path 6 5"]), "race-track"
    )


# --- sensors -----------------------------------------------------------------------------------------------


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
