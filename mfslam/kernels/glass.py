"""Glass: seen only where a beam meets it squarely, and else seen through.

Its cells have few hits for their passes, as have those of a person who walked by. What tells them apart is what beams
did that came squarely: these met glass nearly always, and passed where the person was before and after.
"""

import math

import numpy as np

from mfslam.kernels.compiling import helper, kernel
from mfslam.kernels.poses import arc
from mfslam.kernels.surfels import EMPTY, SECTORS, find_patch, patch_place
from mfslam.types import BoolArray, Float32Array, FloatArray, IntArray

SQUARE = math.cos(math.radians(10.0))  # cosine of incidence from which a beam meets a surface squarely


@kernel
def count_square(
    lines: FloatArray,
    ranges: Float32Array,
    poses: FloatArray,
    twists: FloatArray,
    angles: FloatArray,
    times: FloatArray,
    mount: FloatArray,
    limits: tuple[float, float, float],
    sigma: float,
    met: IntArray,
    passed: IntArray,
) -> None:
    """Count for each patch, ``lines`` (K, 5), the scans (C, N) of which a beam met it squarely (``met`` (K,)), or would have,
    and went on beyond it (``passed``).

    ``angles`` (N,) rise. ``poses`` (C, 3), ``twists`` (C, 6), ``times`` (N,): as for `raytrace.place_beams`. ``limits``: shortest
    and longest range of a hit, and how far patches are looked at.
    """
    range_min, range_max, far = limits
    n = ranges.shape[1]
    step = (angles[n - 1] - angles[0]) / max(1, n - 1)
    middle = n // 2
    for k in range(ranges.shape[0]):
        sx, sy, heading = _laser_at(poses[k], twists[k], times[middle], mount)
        for q in range(lines.shape[0]):
            dx, dy = lines[q, 0] - sx, lines[q, 1] - sy
            square = dx * dx + dy * dy
            across = -(lines[q, 2] * dx + lines[q, 3] * dy)
            # a robot moves little during a scan: a first look at where it was in the middle of it
            if square > far * far or across < 0.0 or across * across < 0.88 * square:
                continue
            j = _beam_towards(math.atan2(dy, dx) - heading, angles, step)
            if j < 0:
                continue
            bx, by, bearing = _laser_at(poses[k], twists[k], times[j], mount)
            dx, dy = lines[q, 0] - bx, lines[q, 1] - by
            j = _beam_towards(math.atan2(dy, dx) - bearing, angles, step)
            if j < 0:
                continue
            c, s = math.cos(bearing + angles[j]), math.sin(bearing + angles[j])
            facing = -(lines[q, 2] * c + lines[q, 3] * s)
            if facing < SQUARE:
                continue
            beyond = ranges[k, j] + (lines[q, 2] * dx + lines[q, 3] * dy) / facing
            if not ranges[k, j] >= range_min:
                continue
            if abs(beyond) <= 3.0 * sigma and ranges[k, j] < range_max:
                met[q] += 1
            elif beyond > 0.0:
                passed[q] += 1


@helper
def _laser_at(
    pose: FloatArray, twist: FloatArray, time: float, mount: FloatArray
) -> tuple[float, float, float]:
    half = 0.5 * time
    x, y, turn = arc(
        time * (twist[0] + half * twist[3]),
        time * (twist[1] + half * twist[4]),
        time * (twist[2] + half * twist[5]),
    )
    c, s = math.cos(pose[2]), math.sin(pose[2])
    px, py, heading = pose[0] + c * x - s * y, pose[1] + s * x + c * y, pose[2] + turn
    c, s = math.cos(heading), math.sin(heading)
    return px + c * mount[0] - s * mount[1], py + s * mount[0] + c * mount[1], heading + mount[2]


@helper
def _beam_towards(bearing: float, angles: FloatArray, step: float) -> int:
    """The beam nearest to a bearing; -1 where none points there."""
    n = angles.shape[0]
    bearing -= 2.0 * math.pi * math.floor((bearing - angles[0] + 0.5 * step) / (2.0 * math.pi))
    at = min(n - 1, max(0, round((bearing - angles[0]) / step)))
    while at + 1 < n and angles[at + 1] <= bearing:
        at += 1
    while at > 0 and angles[at - 1] > bearing:
        at -= 1
    if at + 1 < n and angles[at + 1] - bearing < abs(bearing - angles[at]):
        at += 1
    elif at > 0 and bearing - angles[at - 1] < abs(bearing - angles[at]):
        at -= 1
    return at if abs(angles[at] - bearing) <= step else -1


@kernel
def share_behind(
    keys: IntArray, sums: FloatArray, lines: FloatArray, cell: float, sigma: float
) -> FloatArray:
    """Hits close behind each line (K, 5), up to 0.2 m, over those on it, 0.1 m to either side."""
    share = np.zeros(lines.shape[0])
    reach = math.ceil(0.2 / cell) + 1
    for k in range(lines.shape[0]):
        x, y, nx, ny = lines[k, 0], lines[k, 1], lines[k, 2], lines[k, 3]
        ix, iy = math.floor(x / cell), math.floor(y / cell)
        on = behind = 0.0
        for near_x in range(ix - reach, ix + reach + 1):
            for near_y in range(iy - reach, iy + reach + 1):
                for sector in range(SECTORS):
                    slot = find_patch(keys, near_x, near_y, sector)
                    if keys[slot] == EMPTY:
                        continue
                    dx, dy = sums[slot, 1] / sums[slot, 0] - x, sums[slot, 2] / sums[slot, 0] - y
                    off, along = nx * dx + ny * dy, nx * dy - ny * dx
                    facing = nx * sums[slot, 3] + ny * sums[slot, 4]
                    if abs(along) > 0.1 or facing < 0.0:
                        continue
                    if abs(off) <= 2.5 * sigma:
                        on += sums[slot, 0]
                    elif -0.2 <= off < 0.0:
                        behind += sums[slot, 0]
        share[k] = behind / max(on, 1.0)
    return share


@kernel
def keep_runs(
    keys: IntArray, lines: FloatArray, glassy: BoolArray, cell: float, sigma: float, least: int
) -> BoolArray:
    """Which of the ``glassy`` patches (slots,) lie in a straight run of at least ``least`` of them, without a gap of more than one."""
    kept = np.zeros(glassy.shape[0], np.bool_)
    for slot in range(glassy.shape[0]):
        if not glassy[slot]:
            continue
        _, _, sector = patch_place(keys[slot])
        run = 1
        for side in (-1, 1):
            missed = 0
            for step in range(1, least):
                x = lines[slot, 0] - side * step * cell * lines[slot, 3]
                y = lines[slot, 1] + side * step * cell * lines[slot, 2]
                if _is_glassy(keys, lines, glassy, x, y, lines[slot, 2], lines[slot, 3], sector, cell, sigma):
                    run += 1 + missed
                    missed = 0
                elif missed == 1:
                    break
                else:
                    missed = 1
        kept[slot] = run >= least
    return kept


@helper
def _is_glassy(
    keys: IntArray,
    lines: FloatArray,
    glassy: BoolArray,
    x: float,
    y: float,
    nx: float,
    ny: float,
    sector: int,
    cell: float,
    sigma: float,
) -> bool:
    ix, iy = math.floor(x / cell), math.floor(y / cell)
    for near_x in range(ix - 1, ix + 2):
        for near_y in range(iy - 1, iy + 2):
            for turn in range(-1, 2):
                slot = find_patch(keys, near_x, near_y, (sector + turn) % SECTORS)
                if keys[slot] == EMPTY or not glassy[slot]:
                    continue
                dx, dy = lines[slot, 0] - x, lines[slot, 1] - y
                if (
                    abs(nx * dx + ny * dy) < 2.0 * sigma
                    and abs(nx * dy - ny * dx) < cell
                    and nx * lines[slot, 2] + ny * lines[slot, 3] > 0.9
                ):
                    return True
    return False


@kernel
def draw_lines(lines: FloatArray, half: float, origin: FloatArray, cell: float, occupied: BoolArray) -> None:
    """Set the cells that patches (K, 5) cover, ``half`` m to either side along their lines."""
    rows, cols = occupied.shape
    for k in range(lines.shape[0]):
        steps = max(1, math.ceil(4.0 * half / cell))
        for step in range(steps + 1):
            along = half * (2.0 * step / steps - 1.0)
            col = math.floor((lines[k, 0] - along * lines[k, 3] - origin[0]) / cell)
            row = math.floor((lines[k, 1] + along * lines[k, 2] - origin[1]) / cell)
            if 0 <= row < rows and 0 <= col < cols:
                occupied[row, col] = True
