"""Random office floors by seed: a corridor with rooms on both sides, furniture, doors, people."""

from __future__ import annotations

import numpy as np

from drivers.simulator.world import World, parse_world

CORRIDOR_M = 2.2
ROOM_DEPTH_M = 5.0
DOORWAY_M = 1.1


def random_office(seed: int, rooms_per_side: int = 5, laps: int = 1, speed_m_s: float = 1.0) -> World:
    """An office world whose path visits every room, ``laps`` times, and ends where it began."""
    return parse_world(random_office_text(seed, rooms_per_side, laps, speed_m_s), f"office-{seed}")


def random_office_text(
    seed: int, rooms_per_side: int = 5, laps: int = 1, speed_m_s: float = 1.0, people: int = 1
) -> str:
    """The same as world text, to write to a file. A lap is about 15 m of driving per room."""
    if rooms_per_side < 1 or laps < 1 or speed_m_s <= 0.0:
        raise ValueError(f"expected rooms, laps and speed above 0: {rooms_per_side}, {laps}, {speed_m_s}")
    rng = np.random.default_rng(seed)
    half = 0.5 * CORRIDOR_M
    lines = [f"# random office, seed {seed}"]
    visits: dict[float, list[list[tuple[float, float]]]] = {1.0: [], -1.0: []}
    length = 0.0
    for side in (1.0, -1.0):
        x = 0.0
        for _ in range(rooms_per_side):
            width = float(rng.uniform(4.0, 6.5))
            room, visit = _room(rng, x, width, side, half)
            lines += room
            visits[side].append(visit)
            x += width
        length = max(length, x)
        lines.append(f"wall {x:.2f} {side * half:.2f} {x:.2f} {side * (half + ROOM_DEPTH_M):.2f}")
        visits[side].append([(x, 0.0)])
    ends = {side: visits[side].pop()[0][0] for side in (1.0, -1.0)}
    length += 2.0
    for side, end in ends.items():  # the corridor goes on a little beyond the rooms at both ends
        lines.append(f"wall {end:.2f} {side * half:.2f} {length:.2f} {side * half:.2f}")
        lines.append(f"wall -2 {side * half:.2f} 0 {side * half:.2f}")
    lines.append(f"wall -2 {-half:.2f} -2 {half:.2f}")
    lines.append(f"wall {length:.2f} {-half:.2f} {length:.2f} {half:.2f}")
    for _ in range(people):
        a, b = rng.uniform(0.0, length, 2)
        lines.append(f"person 0.2 0.9 {a:.2f} {half - 0.3:.2f} {b + 1.0:.2f} {half - 0.3:.2f}")
    lines += [f"path -1 0 {speed_m_s:g}", "path 0 0"]
    for _ in range(laps):
        for visit in visits[1.0]:
            lines += [f"path {x:.2f} {y:.2f}" for x, y in visit]
        lines.append(f"path {length - 1.0:.2f} 0")
        for visit in reversed(visits[-1.0]):
            lines += [f"path {x:.2f} {y:.2f}" for x, y in reversed(visit)]
        lines.append("path 0 0")
    return "\n".join([*lines, "path -1 0", ""])


def _room(
    rng: np.random.Generator, x: float, width: float, side: float, half: float
) -> tuple[list[str], list[tuple[float, float]]]:
    """Lines of one room whose left wall stands at ``x``, and the way through it from the corridor."""
    door = x + float(rng.uniform(1.5, width - 1.5))
    near, far = side * half, side * (half + ROOM_DEPTH_M)
    left, right = door - 0.5 * DOORWAY_M, door + 0.5 * DOORWAY_M
    lines = [
        f"wall {left:.2f} {near:.2f} {x:.2f} {near:.2f} {x:.2f} {far:.2f} {x + width:.2f} {far:.2f}",
        f"wall {right:.2f} {near:.2f} {x + width:.2f} {near:.2f}",
    ]
    opening = side * float(rng.uniform(90.0, 120.0))
    lines.append(f"door {left:.2f} {near:.2f} {right:.2f} {near:.2f} {opening:.0f} 0")
    for _ in range(int(rng.integers(1, 4))):  # desks and cupboards along the far wall
        w, d = rng.uniform(0.5, 1.6), rng.uniform(0.3, 0.8)
        cx = float(rng.uniform(x + 0.5 * w + 0.05, x + width - 0.5 * w - 0.05))
        lines.append(f"box {cx:.2f} {far - side * (0.5 * d + 0.02):.2f} {w:.2f} {d:.2f}")
    if rng.random() < 0.4:
        lines.append(f"pillar {x + width - 0.4:.2f} {far - side * 2.0:.2f} 0.15")
    if rng.random() < 0.3:
        lines.append(f"box {x + 0.3:.2f} {far - side * 2.2:.2f} 0.4 1.0")
    deep, mid = near + side * 2.9, near + side * 1.5
    a, b = max(x + 1.3, door - 1.0), min(x + width - 1.3, door + 1.0)
    visit = [(door, 0.0), (door, mid), (a, deep), (b, deep), (door, mid), (door, 0.0)]
    return lines, visit
