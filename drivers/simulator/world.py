"""Simulated worlds and their text format.

One item per line, metres and degrees, ``#`` starts a comment:

    wall   x1 y1 x2 y2 [x3 y3 ...]        a line of walls through the points
    glass  x1 y1 x2 y2 [x3 y3 ...]        seen only within 15 deg of the perpendicular
    box    x y width depth [yaw]          furniture: a closed rectangle about its centre
    pillar x y radius                     a round column
    door   x1 y1 x2 y2 opening period     hinge at the first point, closed end at the second; swings to
                                          `opening` degrees and back in `period` s (0: stands open)
    person radius speed x1 y1 x2 y2 ...   walks along the points and back, m/s
    start  x y yaw                        the robot's first pose (default: at the first `path` point,
                                          looking at the second)
    path   x y [speed]                    where the robot drives next, and how fast at most, m/s
    pause  seconds                        stands still at the path point above
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from drivers.simulator.grid import Grid, grid_over
from drivers.simulator.pursuit import CREEP_M_S
from mfslam.settings import did_you_mean
from mfslam.types import FloatArray, MfslamError

GLASS_MIN_COS = math.cos(math.radians(15.0))
DEFAULT_SPEED_M_S = 1.0


@dataclass(frozen=True, eq=False)
class Door:
    """A leaf of a door that swings: ``hinge_m`` and ``closed_end_m`` (2,)."""

    hinge_m: FloatArray
    closed_end_m: FloatArray
    opening_rad: float
    period_s: float

    def at(self, times_s: FloatArray) -> FloatArray:
        """The leaf as a segment (..., 4) at times (...): opens and closes once per period."""
        swing = 0.5 - 0.5 * np.cos(2.0 * np.pi * times_s / self.period_s) if self.period_s > 0.0 else 1.0
        angle = self.opening_rad * swing * np.ones_like(times_s)
        dx, dy = self.closed_end_m - self.hinge_m
        c, s = np.cos(angle), np.sin(angle)
        x, y = self.hinge_m[0] + c * dx - s * dy, self.hinge_m[1] + s * dx + c * dy
        return np.stack([np.full_like(x, self.hinge_m[0]), np.full_like(y, self.hinge_m[1]), x, y], axis=-1)


@dataclass(frozen=True, eq=False)
class Person:
    """A disc that walks along ``points_m`` (P, 2) and back for ever."""

    radius_m: float
    speed_m_s: float
    points_m: FloatArray

    def at(self, times_s: FloatArray) -> FloatArray:
        """The disc (..., 3) x y r at times (...)."""
        along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(self.points_m, axis=0).T))])
        walked = np.mod(self.speed_m_s * times_s, 2.0 * along[-1])
        s = np.minimum(walked, 2.0 * along[-1] - walked)
        x = np.interp(s, along, self.points_m[:, 0])
        y = np.interp(s, along, self.points_m[:, 1])
        return np.stack([x, y, np.full_like(x, self.radius_m)], axis=-1)


@dataclass(frozen=True, eq=False)
class World:
    """What beams can hit, and the path through it.

    ``segments`` (M, 4): x1 y1 x2 y2; ``min_cos`` (M,): 0 for walls, for glass the cosine of incidence
    below which it is not seen. ``circles`` (C, 3): x y r. ``path_m`` (W, 2) with ``speeds_m_s`` (W,): the
    limit on the way to each point, and ``pauses_s`` (W,). ``start`` (3,): first pose.
    """

    name: str
    segments: FloatArray
    min_cos: FloatArray
    circles: FloatArray
    doors: tuple[Door, ...]
    people: tuple[Person, ...]
    start: FloatArray
    path_m: FloatArray
    speeds_m_s: FloatArray
    pauses_s: FloatArray

    @cached_property
    def grid(self) -> Grid:
        """What stands still, by place."""
        return grid_over(self.segments, self.circles)


@dataclass
class _Draft:
    default_speed_m_s: float
    segments: list[tuple[float, ...]] = field(default_factory=list)
    min_cos: list[float] = field(default_factory=list)
    circles: list[tuple[float, ...]] = field(default_factory=list)
    doors: list[Door] = field(default_factory=list)
    people: list[Person] = field(default_factory=list)
    start: tuple[float, ...] | None = None
    path: list[tuple[float, float]] = field(default_factory=list)
    speeds: list[float] = field(default_factory=list)
    pauses: list[float] = field(default_factory=list)

    def polyline(self, v: list[float], min_cos: float) -> None:
        if len(v) % 2:
            raise ValueError("the points need an even count of numbers")
        for i in range(0, len(v) - 2, 2):
            if v[i : i + 2] == v[i + 2 : i + 4]:
                raise ValueError("two points in a row are the same")
            self.segments.append(tuple(v[i : i + 4]))
            self.min_cos.append(min_cos)

    def wall(self, v: list[float]) -> None:
        self.polyline(v, 0.0)

    def glass(self, v: list[float]) -> None:
        self.polyline(v, GLASS_MIN_COS)

    def box(self, v: list[float]) -> None:
        x, y, width, depth = v[:4]
        _positive(width=width, depth=depth)
        yaw = math.radians(v[4]) if len(v) > 4 else 0.0
        c, s = math.cos(yaw), math.sin(yaw)
        corners: list[float] = []
        for u, w in ((-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)):
            a, b = 0.5 * u * width, 0.5 * w * depth
            corners += [x + c * a - s * b, y + s * a + c * b]
        self.polyline(corners, 0.0)

    def pillar(self, v: list[float]) -> None:
        _positive(radius=v[2])
        self.circles.append(tuple(v))

    def door(self, v: list[float]) -> None:
        if v[5] < 0.0:
            raise ValueError("the period must not be negative")
        if v[:2] == v[2:4]:
            raise ValueError("hinge and closed end are the same point")
        door = Door(np.array(v[:2]), np.array(v[2:4]), math.radians(v[4]), v[5])
        if door.period_s > 0.0:
            self.doors.append(door)
        else:
            self.polyline([float(u) for u in door.at(np.zeros(1))[0]], 0.0)

    def person(self, v: list[float]) -> None:
        _positive(radius=v[0], speed=v[1])
        if len(v) % 2:
            raise ValueError("the points need an even count of numbers")
        points = np.array(v[2:]).reshape(-1, 2)
        if not np.any(np.diff(points, axis=0)):
            raise ValueError("the points are all the same")
        self.people.append(Person(v[0], v[1], points))

    def set_start(self, v: list[float]) -> None:
        if self.start is not None:
            raise ValueError("a second start")
        self.start = (v[0], v[1], math.radians(v[2]))

    def add_path(self, v: list[float]) -> None:
        speed = v[2] if len(v) > 2 else (self.speeds[-1] if self.speeds else self.default_speed_m_s)
        if speed < CREEP_M_S:
            raise ValueError(f"the speed must be at least {CREEP_M_S:g} m/s, got {speed:g}")
        self.path.append((v[0], v[1]))
        self.speeds.append(speed)
        self.pauses.append(0.0)

    def pause(self, v: list[float]) -> None:
        if not self.path:
            raise ValueError("a pause needs a path point above it")
        _positive(seconds=v[0])
        self.pauses[-1] += v[0]

    def first_pose(self) -> tuple[float, ...]:
        if self.start is not None:
            return self.start
        if not self.path:
            return (0.0, 0.0, 0.0)
        x, y = self.path[0]
        ahead = next((p for p in self.path[1:] if p != self.path[0]), (x + 1.0, y))
        return (x, y, math.atan2(ahead[1] - y, ahead[0] - x))


_Item = tuple[Callable[[_Draft, list[float]], None], int, int | None, str]
_ITEMS: dict[str, _Item] = {  # what it does, fewest and most numbers, how it is written
    "wall": (_Draft.wall, 4, None, "wall x1 y1 x2 y2 [x3 y3 ...]"),
    "glass": (_Draft.glass, 4, None, "glass x1 y1 x2 y2 [x3 y3 ...]"),
    "box": (_Draft.box, 4, 5, "box x y width depth [yaw]"),
    "pillar": (_Draft.pillar, 3, 3, "pillar x y radius"),
    "door": (_Draft.door, 6, 6, "door x1 y1 x2 y2 opening period"),
    "person": (_Draft.person, 6, None, "person radius speed x1 y1 x2 y2 ..."),
    "start": (_Draft.set_start, 3, 3, "start x y yaw"),
    "path": (_Draft.add_path, 2, 3, "path x y [speed]"),
    "pause": (_Draft.pause, 1, 1, "pause seconds"),
}


def _positive(**values: float) -> None:
    for name, value in values.items():
        if value <= 0.0:
            raise ValueError(f"the {name} must be more than 0, got {value:g}")


def parse_world(text: str, name: str = "world", default_speed_m_s: float = DEFAULT_SPEED_M_S) -> World:
    """A world from its text. Raises MfslamError ``name:line: ...`` for anything not understood.

    ``default_speed_m_s``: limit until a path point states one.
    """
    draft = _Draft(default_speed_m_s=default_speed_m_s)
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.partition("#")[0].split()
        if words:
            try:
                _parse_item(draft, words[0], words[1:])
            except ValueError as error:
                raise MfslamError(f"{name}:{number}: {error}") from None
    if not (draft.segments or draft.circles):
        raise MfslamError(f"{name}: nothing to see in it: expected at least one wall, box or pillar")
    return World(
        name=name,
        segments=np.array(draft.segments, dtype=np.float64).reshape(-1, 4),
        min_cos=np.array(draft.min_cos, dtype=np.float64),
        circles=np.array(draft.circles, dtype=np.float64).reshape(-1, 3),
        doors=tuple(draft.doors),
        people=tuple(draft.people),
        start=np.array(draft.first_pose()),
        path_m=np.array(draft.path, dtype=np.float64).reshape(-1, 2),
        speeds_m_s=np.array(draft.speeds, dtype=np.float64),
        pauses_s=np.array(draft.pauses, dtype=np.float64),
    )


def _parse_item(draft: _Draft, kind: str, words: list[str]) -> None:
    if kind not in _ITEMS:
        hint = did_you_mean(kind, _ITEMS) or "."
        raise ValueError(f"no such item {kind!r}{hint} Known: {', '.join(_ITEMS)}")
    act, fewest, most, usage = _ITEMS[kind]
    if len(words) < fewest or (most is not None and len(words) > most):
        raise ValueError(f"expected `{usage}`, got {len(words)} numbers")
    values = []
    for word in words:
        try:
            value = float(word)
        except ValueError:
            raise ValueError(f"expected a number, got {word!r} (`{usage}`)") from None
        if not math.isfinite(value):
            raise ValueError(f"expected a finite number, got {word!r}")
        values.append(value)
    act(draft, values)
