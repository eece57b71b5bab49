"""From the ranges of one scan to oriented points: per-beam projection, normals, thinning."""

import math

import numpy as np

from mfslam.kernels.compiling import helper, kernel
from mfslam.kernels.poses import after_arc
from mfslam.types import BoolArray, Float32Array, FloatArray, IntArray


@kernel
def oriented_points(
    ranges: Float32Array, directions: FloatArray, times: FloatArray, mount: FloatArray, twist: FloatArray,
    range_min: float, range_max: float, beam_step: float, sigma: float, spacing: float, doubtful: bool,
) -> tuple[FloatArray, FloatArray, IntArray]:  # fmt: skip
    """A scan's points and normals (M, 2) in the body frame at time 0, and their beams (M,): `project_beams`,
    `estimate_normals`, then, with a ``spacing``, `thin_points`."""
    points, beams = project_beams(ranges, directions, times, mount, twist, range_min, range_max)
    normals = estimate_normals(points, beams, mount, beam_step, sigma, doubtful)
    if spacing > 0.0:
        keep = thin_points(points, normals, beams, mount, beam_step, spacing)
        m = 0
        for k in range(keep.shape[0]):
            if keep[k]:
                points[m, 0], points[m, 1] = points[k, 0], points[k, 1]
                normals[m, 0], normals[m, 1] = normals[k, 0], normals[k, 1]
                beams[m] = beams[k]
                m += 1
        return points[:m].copy(), normals[:m].copy(), beams[:m].copy()
    return points, normals, beams


@helper
def project_beams(
    ranges: Float32Array,
    directions: FloatArray,
    times: FloatArray,
    mount: FloatArray,
    twist: FloatArray,
    range_min: float,
    range_max: float,
) -> tuple[FloatArray, IntArray]:
    """End points of the valid beams in the body frame at time 0, each from the body's pose at its time.

    ``directions`` (N, 2): unit vectors along the beams, in the axes of the body. ``times`` (N,): instants of the beams
    from the reference, s. ``twist`` (3,): body velocity held through the scan, or (6,): that at time 0, and its change
    per second. Eqs. 16-18 with an exact arc and the mount in between.
    Returns points (M, 2) and the index (M,) of their beams.
    """
    n = ranges.shape[0]
    points = np.empty((n, 2))
    beams = np.empty(n, np.int64)
    m = 0
    still = not twist.any()
    changes = twist.shape[0] == 6
    vx, vy, turn = twist[0], twist[1], twist[2]
    for j in range(n):
        r = ranges[j]
        if not (range_min <= r < range_max):
            continue
        bx, by = mount[0] + r * directions[j, 0], mount[1] + r * directions[j, 1]
        if not still:
            t = times[j]
            if changes:  # the mean over 0 to t of the twist v + a s
                share = 0.5 * t
                vx, vy = twist[0] + share * twist[3], twist[1] + share * twist[4]
                turn = twist[2] + share * twist[5]
            bx, by = after_arc(vx * t, vy * t, turn * t, bx, by)
        points[m, 0], points[m, 1] = bx, by
        beams[m] = j
        m += 1
    return points[:m], beams[:m]


@helper
def estimate_normals(
    points: FloatArray,
    beams: IntArray,
    origin: FloatArray,
    beam_step: float,
    sigma: float,
    doubtful: bool = False,
) -> FloatArray:
    """Normals (M, 2) facing the sensor, by a line through each point's neighbours in beam order.

    (0, 0) where there are fewer than three, or where they are no line: spread across it above 3 sigma, or above a fifth of
    the spread along it. ``doubtful``: those as well that may be lines but for the noise, and walls seen at such a slant that
    three beams alone meet them; for whoever weighs them against other scans.
    """
    m = points.shape[0]
    normals = np.zeros((m, 2))
    reach = 16  # beams to either side at most
    noise = sigma * sigma
    forgiven = 2.0 * noise if doubtful else 0.0
    for k in range(m):
        px, py = points[k, 0], points[k, 1]
        dx, dy = px - origin[0], py - origin[1]
        dist = math.sqrt(dx * dx + dy * dy)
        # wide enough that noise does not turn the line, and that sparse beams find neighbours
        radius = max(0.15, 8.0 * sigma, 4.0 * dist * beam_step)
        r2 = min(4.0, max(radius * radius, _apart_at_a_slant(points, beams, k) if doubtful else 0.0))
        cnt = 1
        sx = sy = sxx = sxy = syy = 0.0
        for side in (-1, 1):
            for step in range(1, reach + 1):
                q = k + side * step
                if q < 0 or q >= m or abs(beams[q] - beams[k]) > step + 2:
                    break
                ex, ey = points[q, 0] - px, points[q, 1] - py
                if ex * ex + ey * ey > r2:
                    break
                sx += ex
                sy += ey
                sxx += ex * ex
                sxy += ex * ey
                syy += ey * ey
                cnt += 1
        if cnt < 3:
            continue
        mx, my = sx / cnt, sy / cnt
        cxx, cxy, cyy = sxx / cnt - mx * mx, sxy / cnt - mx * my, syy / cnt - my * my
        half_trace, half_diff = 0.5 * (cxx + cyy), 0.5 * (cxx - cyy)
        root = math.sqrt(half_diff * half_diff + cxy * cxy)
        small, large = max(0.0, half_trace - root), half_trace + root
        if large < 1e-8 or small > min(9.0 * noise, 0.04 * large + forgiven, 0.25 * large):
            continue
        # the eigenvector of the small eigenvalue, turned towards the sensor
        nx, ny = cxy, -half_diff - root
        if half_diff < 0.0:
            nx, ny = half_diff - root, cxy
        length = math.sqrt(nx * nx + ny * ny)
        if nx * dx + ny * dy > 0.0:
            length = -length
        nx, ny = nx / length, ny / length
        normals[k, 0], normals[k, 1] = nx, ny
    return normals


@helper
def _apart_at_a_slant(points: FloatArray, beams: IntArray, k: int) -> float:
    """Twice the square of how far a point's neighbours stand, if they look like beams that meet one wall at a slant: far apart,
    but evenly, and in one line. Such beams tell most of the heading."""
    if k == 0 or k == points.shape[0] - 1 or beams[k + 1] - beams[k - 1] > 4:
        return 0.0
    ax, ay = points[k, 0] - points[k - 1, 0], points[k, 1] - points[k - 1, 1]
    bx, by = points[k + 1, 0] - points[k, 0], points[k + 1, 1] - points[k, 1]
    a2, b2, along = ax * ax + ay * ay, bx * bx + by * by, ax * bx + ay * by
    if max(a2, b2) > 4.0 * min(a2, b2) or along < 0.0 or along * along < 0.81 * a2 * b2:
        return 0.0
    far: float = 2.0 * max(a2, b2)
    return far


@helper
def thin_points(
    points: FloatArray,
    normals: FloatArray,
    beams: IntArray,
    origin: FloatArray,
    beam_step: float,
    spacing: float,
) -> BoolArray:
    """Which points to keep so that beams stand about ``spacing`` apart where they hit; one with a normal
    is waited for a little.

    Counted by the angle between beams and their range, not by the distance between points: choosing the
    first point that is far enough from the last would favour those that noise has pushed along the sweep,
    and so turn every scan a little in the same sense.
    """
    m = points.shape[0]
    keep = np.zeros(m, np.bool_)
    swept = spacing
    for k in range(m):
        if k > 0:
            dx, dy = points[k, 0] - origin[0], points[k, 1] - origin[1]
            swept += math.sqrt(dx * dx + dy * dy) * beam_step * (beams[k] - beams[k - 1])
        oriented = normals[k, 0] != 0.0 or normals[k, 1] != 0.0
        if swept >= spacing and (oriented or swept >= 1.5 * spacing):
            keep[k] = True
            swept = min(swept - spacing, spacing)
    return keep
