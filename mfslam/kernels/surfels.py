"""Surfaces that all scans agree on: oriented patches of what hits lie on, and hits moved onto them.

A cheap form of sparse surface adjustment (Ruhnke, Kümmerle, Grisetti, Burgard, Highly accurate 2D laser mapping by
sparse surface adjustment, ICRA 2011) for the map alone: poses stay, points move along the normals of
their surface, within their noise.
"""

import math

import numpy as np

from mfslam.kernels.compiling import helper, kernel
from mfslam.kernels.raytrace import HIT, KindArray
from mfslam.kernels.scans import estimate_normals
from mfslam.types import FloatArray, Int8Array, IntArray

# keys of the patches; hits, sums of x, y, and of the normals' x, y (slots, 5)
PatchTable = tuple[IntArray, FloatArray]

EMPTY = np.iinfo(np.int64).min
SECTORS = 8  # of the direction that a patch faces
_HALF_SECTOR = math.tan(math.pi / SECTORS)
NO_FACING = -1
SAME_WAY = 0.7  # cosine between normals of one surface
SURE_HITS = 10.0  # around a patch: more than chance brings together
MOST_SIGMAS = 4.0  # a hit farther off than this is not of that surface
REACH = 3  # patches to either side that a surface is averaged over


@kernel
def add_hits(
    keys: IntArray,
    sums: FloatArray,
    used: int,
    starts: FloatArray,
    ends: FloatArray,
    kinds: KindArray,
    beam_step: float,
    sigma: float,
    cell: float,
    facings: Int8Array,
) -> tuple[IntArray, FloatArray, int]:
    """Add the hits of scans, (C, N, 2) and (C, N), to a table of patches of ``cell`` m; the table, grown where need be,
    and its patches.

    Fills ``facings`` (C, N): the sector that each hit's surface faces, -1 where its neighbours are no line.
    """
    n = ends.shape[1]
    points, beams = np.empty((n, 2)), np.empty(n, np.int64)
    for k in range(ends.shape[0]):
        m = 0
        for j in range(n):
            facings[k, j] = NO_FACING
            if kinds[k, j] == HIT:
                points[m, 0], points[m, 1] = ends[k, j, 0], ends[k, j, 1]
                beams[m] = j
                m += 1
        normals = estimate_normals(points[:m], beams[:m], starts[k, n // 2], beam_step, sigma)
        for i in range(m):
            nx, ny = normals[i, 0], normals[i, 1]
            if nx == 0.0 and ny == 0.0:
                continue
            sector = _sector(nx, ny)
            facings[k, beams[i]] = sector
            if 2 * used >= keys.shape[0]:
                keys, sums = _grown(keys, sums)
            ix, iy = math.floor(points[i, 0] / cell), math.floor(points[i, 1] / cell)
            slot = find_patch(keys, ix, iy, sector)
            if keys[slot] == EMPTY:
                keys[slot] = _key(ix, iy, sector)
                used += 1
            sums[slot, 0] += 1.0
            sums[slot, 1] += points[i, 0]
            sums[slot, 2] += points[i, 1]
            sums[slot, 3] += nx
            sums[slot, 4] += ny
    return keys, sums, used


@helper
def _sector(nx: float, ny: float) -> int:
    """Of `SECTORS`, which are eight, that about the direction: 0 about x, counterclockwise."""
    across, along = abs(ny), abs(nx)
    if across < _HALF_SECTOR * along:
        return 0 if nx > 0.0 else 4
    if along < _HALF_SECTOR * across:
        return 2 if ny > 0.0 else 6
    if ny > 0.0:
        return 1 if nx > 0.0 else 3
    return 7 if nx > 0.0 else 5


@kernel
def find_patch(keys: IntArray, ix: int, iy: int, sector: int) -> int:
    """Slot of a patch, or of the free place where it would go. The patches of one cell share a line of the cache."""
    key = _key(ix, iy, sector)
    h = ((ix << 32) ^ (iy & 0xFFFFFFFF)) * -7046029254386353131
    h ^= h >> 29
    mask = keys.shape[0] - 1
    slot: int = ((h << 3) | sector) & mask
    while keys[slot] != key and keys[slot] != EMPTY:
        slot = (slot + 1) & mask
    return slot


@helper
def _key(ix: int, iy: int, sector: int) -> int:
    return ((ix * SECTORS + sector) << 32) ^ (iy & 0xFFFFFFFF)


@kernel
def patch_place(key: int) -> tuple[int, int, int]:
    """Cell, x and y, and sector of a key."""
    iy = key & 0xFFFFFFFF
    return (key >> 32) // SECTORS, iy - ((iy >> 31) << 32), (key >> 32) % SECTORS


@helper
def _grown(keys: IntArray, sums: FloatArray) -> PatchTable:
    more_keys = np.full(2 * keys.shape[0], EMPTY, np.int64)
    more_sums = np.zeros((2 * keys.shape[0], 5))
    for old in range(keys.shape[0]):
        if keys[old] != EMPTY:
            ix, iy, sector = patch_place(keys[old])
            slot = find_patch(more_keys, ix, iy, sector)
            more_keys[slot] = keys[old]
            for u in range(5):
                more_sums[slot, u] = sums[old, u]
    return more_keys, more_sums


@kernel
def fit_surfaces(
    keys: IntArray, sums: FloatArray, order: IntArray, cell: float, sigma: float, rounds: int
) -> FloatArray:
    """The line of each patch (slots, 5): a point on it, x and y, the unit normal, and the hits that told it.

    ``order``: the slots that hold one, neighbours near each other, so that what was looked up stays in the cache.

    Mean shift along the normal (Comaniciu and Meer 2002): each patch is carried, with its slope, to the mean of those
    that face the same way around it, weighted by their hits and by how near they are across it. Two surfaces
    a few sigmas apart stay two.
    """
    lines = np.zeros((keys.shape[0], 5))
    for slot in order:
        x, y = sums[slot, 1] / sums[slot, 0], sums[slot, 2] / sums[slot, 0]
        norm = max(math.sqrt(sums[slot, 3] ** 2 + sums[slot, 4] ** 2), 1e-9)
        nx, ny = sums[slot, 3] / norm, sums[slot, 4] / norm
        key = keys[slot]
        told = 0.0
        for turn in range(rounds):
            width = sigma * (2.0 if turn == 0 else 1.0)
            told, shift, tilt = _mean_around(keys, sums, key, x, y, nx, ny, cell, width)
            x, y = x + shift * nx, y + shift * ny
            norm = math.sqrt(1.0 + tilt * tilt)
            nx, ny = (nx + tilt * ny) / norm, (ny - tilt * nx) / norm
        lines[slot, 0], lines[slot, 1], lines[slot, 2], lines[slot, 3] = x, y, nx, ny
        lines[slot, 4] = told
    return lines


@helper
def _mean_around(
    keys: IntArray,
    sums: FloatArray,
    key: int,
    x: float,
    y: float,
    nx: float,
    ny: float,
    cell: float,
    width: float,
) -> tuple[float, float, float]:
    """Hits around a patch, how far along its normal their mean lies, and their slope, rad."""
    ix, iy, sector = patch_place(key)
    reach = REACH * cell
    sw = sa = so = saa = sao = 0.0
    for near_x in range(ix - REACH, ix + REACH + 1):
        for near_y in range(iy - REACH, iy + REACH + 1):
            # by cell first: most lie nowhere near the line
            cx, cy = (near_x + 0.5) * cell - x, (near_y + 0.5) * cell - y
            if (
                abs(nx * cx + ny * cy) > 3.0 * width + 0.75 * cell
                or abs(nx * cy - ny * cx) > reach + 0.75 * cell
            ):
                continue
            for turn in range(-1, 2):
                slot = find_patch(keys, near_x, near_y, (sector + turn) % SECTORS)
                if keys[slot] == EMPTY:
                    continue
                count = sums[slot, 0]
                facing = nx * sums[slot, 3] + ny * sums[slot, 4]
                if facing < SAME_WAY * math.sqrt(sums[slot, 3] ** 2 + sums[slot, 4] ** 2):
                    continue
                dx, dy = sums[slot, 1] / count - x, sums[slot, 2] / count - y
                off, along = nx * dx + ny * dy, nx * dy - ny * dx
                if abs(along) > reach:
                    continue
                weight = count * math.exp(-0.5 * (off / width) ** 2)
                sw += weight
                sa += weight * along
                so += weight * off
                saa += weight * along * along
                sao += weight * along * off
    if sw <= 0.0:
        return 0.0, 0.0, 0.0
    ma, mo = sa / sw, so / sw
    # a short piece does not know its slope: held by as much as a cell along it tells
    tilt = (sao / sw - ma * mo) / (saa / sw - ma * ma + 0.25 * cell * cell)
    return sw, mo - tilt * ma, tilt


@kernel
def adjust_ends(
    keys: IntArray,
    lines: FloatArray,
    cell: float,
    sigma: float,
    facings: Int8Array,
    starts: FloatArray,
    kinds: KindArray,
    ends: FloatArray,
) -> None:
    """Move hits, ``ends`` (C, N, 2), along the normal onto a line of their patch: of those that face about the same
    way, the one that most hits tell, within `MOST_SIGMAS`. Hits that face nowhere go to what many others tell there."""
    for k in range(ends.shape[0]):
        for j in range(ends.shape[1]):
            if kinds[k, j] != HIT:
                continue
            shift_x, shift_y, told = _towards_line(
                keys, lines, cell, sigma, facings[k, j], starts[k, j], ends[k, j], 0
            )
            if told <= SURE_HITS:
                shift_x, shift_y, _ = _towards_line(
                    keys, lines, cell, sigma, facings[k, j], starts[k, j], ends[k, j], 1
                )
            ends[k, j, 0] += shift_x
            ends[k, j, 1] += shift_y


@helper
def _towards_line(
    keys: IntArray,
    lines: FloatArray,
    cell: float,
    sigma: float,
    facing: int,
    start: FloatArray,
    end: FloatArray,
    reach: int,
) -> tuple[float, float, float]:
    """How far, x and y, the best line within ``reach`` cells lies from a hit, and how many hits, by their distance, tell it."""
    x, y = end[0], end[1]
    dx, dy = x - start[0], y - start[1]
    oriented = facing != NO_FACING
    best, shift_x, shift_y = (0.0 if oriented else SURE_HITS), 0.0, 0.0
    first, count = (facing - 1, 3) if oriented else (0, SECTORS)
    ix, iy = math.floor(x / cell), math.floor(y / cell)
    for near_x in range(ix - reach, ix + reach + 1):
        for near_y in range(iy - reach, iy + reach + 1):
            for turn in range(count):
                slot = find_patch(keys, near_x, near_y, (first + turn) % SECTORS)
                if keys[slot] == EMPTY:
                    continue
                nx, ny = lines[slot, 2], lines[slot, 3]
                rx, ry = lines[slot, 0] - x, lines[slot, 1] - y
                off, along = nx * rx + ny * ry, nx * ry - ny * rx
                if (
                    lines[slot, 4] <= best
                    or abs(off) > MOST_SIGMAS * sigma
                    or abs(along) > cell
                    or nx * dx + ny * dy >= 0.0
                ):
                    continue
                told = lines[slot, 4] * math.exp(-0.5 * (off / sigma) ** 2)
                if told > best:
                    best, shift_x, shift_y = told, off * nx, off * ny
    return shift_x, shift_y, best
