"""Where walls end in a scan: between a beam that hits the wall and the next, which passes where the wall would go on."""

import math

import numpy as np

from mfslam.kernels.compiling import helper, kernel
from mfslam.kernels.poses import after_arc
from mfslam.types import BoolArray, Float32Array, FloatArray

WALL_M, LEAST_WALL_M, LEAST_HITS = 0.5, 0.3, 5  # of a wall up to its end: looked at, and seen at least
MOST_LOST = 2  # beams in a row that met nothing do not interrupt it
CLEAR_M, LEAST_PASSING = 0.3, 3  # nothing stands beyond the end: so far, and by so many beams
BEHIND_M = 0.1  # a beam that ends this far behind where the wall would be has passed it
MOST_OPEN_M = 0.25  # an end is known that lies between two beams this far apart on the wall
LEAST_SINE = 0.05  # of the angle at which a beam meets a wall
SIGMAS = 5.0  # of a range, within which it tells nothing


@kernel
def wall_ends(
    ranges: Float32Array, directions: FloatArray, times: FloatArray, mount: FloatArray, twist: FloatArray,
    range_min: float, range_max: float, sigma: float,
) -> FloatArray:  # fmt: skip
    """(E, 5) of the ends that a scan sees, in the body frame at time 0: x, y, the unit vector along the wall out of it, one
    sigma along it.

    ``directions`` (N, 2), ``times`` (N,), ``mount`` (3,), ``twist`` (3,) as of `scans.oriented_points`. A beam that met nothing, or
    of which nothing is known, may have passed.
    """
    n = ranges.shape[0]
    # each beam's origin, and where it ended or, if that is not known, some point along it
    eyes, points, hits = np.empty((n, 2)), np.empty((n, 2)), np.zeros(n, np.bool_)
    for j in range(n):
        t, r = times[j], float(ranges[j])
        hits[j] = range_min <= r < range_max
        along = r if hits[j] else 1.0
        vx, vy, turn = twist[0] * t, twist[1] * t, twist[2] * t
        eyes[j, 0], eyes[j, 1] = after_arc(vx, vy, turn, mount[0], mount[1])
        points[j, 0], points[j, 1] = after_arc(
            vx, vy, turn, mount[0] + along * directions[j, 0], mount[1] + along * directions[j, 1]
        )
    behind = max(BEHIND_M, SIGMAS * sigma)
    out = np.empty((2 * n, 5))
    count = 0
    for k in range(n):
        if not hits[k]:
            continue
        for side in (-1, 1):
            if not 0 <= k + side < n or ranges[k + side] < ranges[k] + behind:
                continue
            is_wall, x, y, tx, ty = _wall_before(points, hits, k, side, sigma)
            if not is_wall:
                continue
            # the range of the last hit is noisy, its bearing is not
            at, ax, ay = _on_wall(eyes, points, k, x, y, tx, ty)
            opens = _opening(
                eyes, points, ranges, k, side, x, y, tx, ty, ax, ay, behind, range_max - SIGMAS * sigma
            )
            if at > 0.0 and 0.0 < opens < MOST_OPEN_M:
                out[count, 0], out[count, 1] = ax + 0.5 * opens * tx, ay + 0.5 * opens * ty
                out[count, 2], out[count, 3] = tx, ty
                out[count, 4] = opens / math.sqrt(12.0)
                count += 1
    return out[:count].copy()


@helper
def _wall_before(
    points: FloatArray, hits: BoolArray, k: int, side: int, sigma: float
) -> tuple[bool, float, float, float, float]:
    """The straight wall of which beam ``k`` hits the last bit, those before lying on the other ``side``: whether there is
    one, a point on it, and the unit vector along it towards its end."""
    n = points.shape[0]
    sx = sy = sxx = sxy = syy = span = 0.0
    count = lost = 0
    q = k
    while 0 <= q < n and lost <= MOST_LOST:
        if hits[q]:
            dx, dy = points[q, 0] - points[k, 0], points[q, 1] - points[k, 1]
            far = math.hypot(dx, dy)
            if far > WALL_M or far < span - BEHIND_M:
                break
            span, lost, count = max(span, far), 0, count + 1
            sx, sy = sx + dx, sy + dy
            sxx, sxy, syy = sxx + dx * dx, sxy + dx * dy, syy + dy * dy
        else:
            lost += 1
        q -= side
    if count < LEAST_HITS or span < LEAST_WALL_M:
        return False, 0.0, 0.0, 0.0, 0.0
    mx, my = sx / count, sy / count
    cxx, cxy, cyy = sxx / count - mx * mx, sxy / count - mx * my, syy / count - my * my
    half_trace, half_diff = 0.5 * (cxx + cyy), 0.5 * (cxx - cyy)
    across2 = half_trace - math.sqrt(half_diff * half_diff + cxy * cxy)
    angle = 0.5 * math.atan2(cxy, half_diff)
    tx, ty = math.cos(angle), math.sin(angle)
    if tx * mx + ty * my > 0.0:
        tx, ty = -tx, -ty
    is_wall = across2 < 4.0 * sigma * sigma and abs(tx * my - ty * mx) < 2.5 * sigma
    return is_wall, points[k, 0] + mx, points[k, 1] + my, tx, ty


@helper
def _on_wall(
    eyes: FloatArray, points: FloatArray, j: int, x: float, y: float, tx: float, ty: float
) -> tuple[float, float, float]:
    """How far along beam ``j`` it meets a wall's line, and where; 0 where it does not, or at too small an angle."""
    ux, uy = points[j, 0] - eyes[j, 0], points[j, 1] - eyes[j, 1]
    length = math.hypot(ux, uy)
    ux, uy = ux / length, uy / length
    sine = tx * uy - ty * ux
    if abs(sine) < LEAST_SINE:
        return 0.0, 0.0, 0.0
    at = (tx * (y - eyes[j, 1]) - ty * (x - eyes[j, 0])) / sine
    return max(at, 0.0), eyes[j, 0] + at * ux, eyes[j, 1] + at * uy


@helper
def _opening(
    eyes: FloatArray, points: FloatArray, ranges: Float32Array, k: int, side: int, x: float, y: float, tx: float, ty: float,
    ax: float, ay: float, behind: float, farthest: float,
) -> float:  # fmt: skip
    """How far beyond the last hit (``ax``, ``ay``) of a wall the next beam passes its line; 0 where the wall may go on."""
    opens = 0.0
    passing = 0
    j = k + side
    while 0 <= j < ranges.shape[0]:
        at, px, py = _on_wall(eyes, points, j, x, y, tx, ty)
        if at == 0.0 or at > farthest:  # a wall there would not be seen
            break
        beyond = tx * (px - ax) + ty * (py - ay)
        if beyond <= 0.0 or ranges[j] < at + behind:
            return 0.0
        if passing == 0:
            opens = beyond
        passing += 1
        if beyond > CLEAR_M:
            break
        j += side
    return opens if passing >= LEAST_PASSING else 0.0
