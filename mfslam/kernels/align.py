"""Iterations of registration: point-to-line (Gauss-Newton) and point-to-point (closed form)."""

import math

import numpy as np
from numba import njit

from mfslam.kernels.cells import CellTable, cell_key, find_slot
from mfslam.kernels.matrices import drop_open_direction, open_direction
from mfslam.kernels.poses import wrap_angle
from mfslam.types import FloatArray

MIN_NORMAL_COS = 0.7  # partners face the same way within 45 deg


@njit(cache=True, nogil=True, inline="always")
def _nearest(
    table: CellTable, cell: float, x: float, y: float, nx: float, ny: float, radius: float, min_cos: float
) -> tuple[int, float]:
    """Row of the nearest point within ``radius`` whose normal agrees (where both have one), or -1."""
    keys, starts, counts, rows = table
    best, best_d2 = -1, radius * radius
    oriented = nx != 0.0 or ny != 0.0
    x0, x1 = math.floor((x - radius) / cell), math.floor((x + radius) / cell)
    y0, y1 = math.floor((y - radius) / cell), math.floor((y + radius) / cell)
    for ix in range(x0, x1 + 1):
        for iy in range(y0, y1 + 1):
            key = cell_key(ix, iy)
            slot = find_slot(keys, key)
            if keys[slot] != key:
                continue
            for q in range(starts[slot], starts[slot] + counts[slot]):
                dx, dy = rows[q, 0] - x, rows[q, 1] - y
                d2 = dx * dx + dy * dy
                if d2 < best_d2:
                    both_oriented = oriented and (rows[q, 2] != 0.0 or rows[q, 3] != 0.0)
                    if both_oriented and nx * rows[q, 2] + ny * rows[q, 3] < min_cos:
                        continue
                    best, best_d2 = q, d2
    return best, best_d2


@njit(cache=True, nogil=True, inline="always")
def line_residual(
    table: CellTable, cell: float, x: float, y: float, own_x: float, own_y: float, radius: float
) -> tuple[int, float, float, float]:
    """Of a point and its own normal: 1, the normal of its partner's line and the distance from it; 0 where
    neither of the two has a normal; -1 without a partner."""
    rows = table[3]
    q, _ = _nearest(table, cell, x, y, own_x, own_y, radius, MIN_NORMAL_COS)
    if q < 0:
        return -1, 0.0, 0.0, 0.0
    nx, ny = rows[q, 2], rows[q, 3]
    if nx == 0.0 and ny == 0.0:
        nx, ny = own_x, own_y
    if nx == 0.0 and ny == 0.0:
        return 0, 0.0, 0.0, 0.0
    return 1, nx, ny, nx * (x - rows[q, 0]) + ny * (y - rows[q, 1])


@njit(cache=True, nogil=True, inline="always")
def geman_mcclure(r: float, scale: float) -> float:
    """Weight of a residual."""
    w = scale * scale / (scale * scale + r * r)
    return w * w


@njit(cache=True, nogil=True, inline="always")
def error_from(prior: FloatArray, pose: FloatArray) -> tuple[float, float, float]:
    """From a pose to a prior near it, in the frame of the pose."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    ex, ey = prior[0] - pose[0], prior[1] - pose[1]
    return c * ex + s * ey, -s * ex + c * ey, wrap_angle(prior[2] - pose[2])


@njit(cache=True, nogil=True, inline="always")
def step_by(pose: FloatArray, dx: float, dy: float, turn: float) -> bool:
    """Move a pose in its own frame, in place; whether that was next to nothing."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    pose[0] += c * dx - s * dy
    pose[1] += s * dx + c * dy
    pose[2] += turn
    return abs(dx) + abs(dy) < 2e-4 and abs(turn) < 1e-4


@njit(cache=True, nogil=True, inline="always")
def _solve3(a: FloatArray, b0: float, b1: float, b2: float) -> tuple[bool, float, float, float]:
    """Solution of the symmetric 3x3 system a x = b by Cramer's rule; False where it is singular."""
    c00 = a[1, 1] * a[2, 2] - a[1, 2] * a[1, 2]
    c01 = a[0, 2] * a[1, 2] - a[0, 1] * a[2, 2]
    c02 = a[0, 1] * a[1, 2] - a[0, 2] * a[1, 1]
    det = a[0, 0] * c00 + a[0, 1] * c01 + a[0, 2] * c02
    if not abs(det) > 1e-12:
        return False, 0.0, 0.0, 0.0
    c11 = a[0, 0] * a[2, 2] - a[0, 2] * a[0, 2]
    c12 = a[0, 1] * a[0, 2] - a[0, 0] * a[1, 2]
    c22 = a[0, 0] * a[1, 1] - a[0, 1] * a[0, 1]
    return (
        True,
        (c00 * b0 + c01 * b1 + c02 * b2) / det,
        (c01 * b0 + c11 * b1 + c12 * b2) / det,
        (c02 * b0 + c12 * b1 + c22 * b2) / det,
    )


@njit(cache=True, nogil=True, inline="always")
def _normal_equations(
    table: CellTable,
    cell: float,
    points: FloatArray,
    normals: FloatArray,
    pose: FloatArray,
    sigma: float,
    scale: float,
    radius: float,
    h: FloatArray,
) -> tuple[float, float, float, float, float, int]:
    """Fill the information ``h`` (3, 3) of all point-to-line residuals at ``pose``.

    Returns the right-hand side b0, b1, b2 of h d = b, the sums of weighted squares and of weights, and the
    number of pairs without any normal.
    """
    c, s = math.cos(pose[2]), math.sin(pose[2])
    inv_s2 = 1.0 / (sigma * sigma)
    h[:] = 0.0
    b0 = b1 = b2 = 0.0
    sum_r2 = 0.0
    weight_sum = 0.0
    mute = 0
    for i in range(points.shape[0]):
        px, py = points[i, 0], points[i, 1]
        x, y = pose[0] + c * px - s * py, pose[1] + s * px + c * py
        wnx = c * normals[i, 0] - s * normals[i, 1]
        wny = s * normals[i, 0] + c * normals[i, 1]
        pair, nx, ny, r = line_residual(table, cell, x, y, wnx, wny, radius)
        if pair <= 0:
            mute += pair == 0
            continue
        w = geman_mcclure(r, scale)
        # d r / d (right perturbation): rotate the normal into the source frame
        j0, j1 = c * nx + s * ny, -s * nx + c * ny
        j2 = j1 * px - j0 * py
        wi = w * inv_s2
        h[0, 0] += wi * j0 * j0
        h[0, 1] += wi * j0 * j1
        h[0, 2] += wi * j0 * j2
        h[1, 1] += wi * j1 * j1
        h[1, 2] += wi * j1 * j2
        h[2, 2] += wi * j2 * j2
        b0 -= wi * j0 * r
        b1 -= wi * j1 * r
        b2 -= wi * j2 * r
        sum_r2 += w * r * r
        weight_sum += w
    h[1, 0], h[2, 0], h[2, 1] = h[0, 1], h[0, 2], h[1, 2]
    return b0, b1, b2, sum_r2, weight_sum, mute


@njit(cache=True, nogil=True)
def point_to_line(
    table: CellTable,
    cell: float,
    points: FloatArray,
    normals: FloatArray,
    guess: FloatArray,
    prior: FloatArray,
    prior_information: FloatArray,
    sigma: float,
    kernel_sigmas: float,
    radius_start: float,
    radius_end: float,
    max_iterations: int,
    open_share: float = 0.0,
) -> tuple[FloatArray, FloatArray, float, float, int, bool]:
    """Robust point-to-line registration from ``guess``, with a Gaussian ``prior`` on the pose.

    Minimises sum rho(n . (T p - q)) / sigma^2 + \\|log(prior^-1 T)\\|^2 by Gauss-Newton on the right
    perturbation of ref_T_src; rho is Geman-McClure of scale ``kernel_sigmas`` sigma. The search radius
    and the scale of the kernel shrink while it converges.
    Returns ref_T_src, the information of the data alone (3, 3), the share of points that found their
    partner (robust weights; pairs without any normal are left out), the root mean square of their
    residuals, iterations and whether it converged.
    """
    pose = guess.copy()
    h = np.zeros((3, 3))
    a = np.zeros((3, 3))
    weight_sum = 0.0
    mute = 0
    rms = 0.0
    converged = False
    iteration = 0
    radius = radius_start
    held = prior_information[0, 0] > 0.0 and prior_information[1, 1] > 0.0
    while iteration < max_iterations:
        iteration += 1
        # the kernel opens with the search radius so that a far guess is not thrown away as outliers
        scale = max(kernel_sigmas * sigma, 0.25 * radius)
        b0, b1, b2, sum_r2, weight_sum, mute = _normal_equations(
            table, cell, points, normals, pose, sigma, scale, radius, h
        )
        rms = math.sqrt(sum_r2 / weight_sum) if weight_sum > 0.0 else 0.0
        data = h
        is_open, v0, v1 = open_direction(h, open_share)
        if is_open and held:
            # what noise feigns along an open direction must not pull against the prior
            data = drop_open_direction(h, open_share)
            along = v0 * b0 + v1 * b1
            b0, b1 = b0 - along * v0, b1 - along * v1
        e0, e1, e2 = error_from(prior, pose)  # small angles
        for u in range(3):
            for v in range(3):
                a[u, v] = data[u, v] + prior_information[u, v]
        b0 += prior_information[0, 0] * e0 + prior_information[0, 1] * e1 + prior_information[0, 2] * e2
        b1 += prior_information[1, 0] * e0 + prior_information[1, 1] * e1 + prior_information[1, 2] * e2
        b2 += prior_information[2, 0] * e0 + prior_information[2, 1] * e1 + prior_information[2, 2] * e2
        ok, d0, d1, d2 = _solve3(a, b0, b1, b2)
        if not ok:
            break
        small = step_by(pose, d0, d1, d2)
        if small and radius <= radius_end:
            converged = True
            break
        if small or iteration >= 2:
            radius = max(radius_end, 0.6 * radius)
    pose[2] = wrap_angle(pose[2])
    h = drop_open_direction(h, open_share)
    return pose, h, weight_sum / max(1, points.shape[0] - mute), rms, iteration, converged


@njit(cache=True, nogil=True)
def rigid_fit(d: FloatArray, m: FloatArray) -> FloatArray:
    """Pose m_T_d (3,) that brings points ``d`` (N, 2) nearest to their partners ``m`` (eqs. 26-39).

    H = sum d' m'^T = U S V^T gives R = V diag(1, det) U^T; the guard keeps it from being a reflection. In
    the plane that rotation is the one whose angle maximises tr(R H), in closed form. t = c_m - R c_d.
    """
    n = d.shape[0]
    dx, dy, mx, my = 0.0, 0.0, 0.0, 0.0
    for i in range(n):  # eqs. 27, 28
        dx += d[i, 0]
        dy += d[i, 1]
        mx += m[i, 0]
        my += m[i, 1]
    dx, dy, mx, my = dx / n, dy / n, mx / n, my / n
    along = across = 0.0
    for i in range(n):  # the parts of H (eq. 34) that a rotation sees: H00 + H11 and H01 - H10
        ux, uy, vx, vy = d[i, 0] - dx, d[i, 1] - dy, m[i, 0] - mx, m[i, 1] - my  # eqs. 29, 30
        along += ux * vx + uy * vy
        across += ux * vy - uy * vx
    theta = math.atan2(across, along)  # eq. 36
    c, s = math.cos(theta), math.sin(theta)
    return np.array([mx - c * dx + s * dy, my - s * dx - c * dy, theta])  # eq. 39


@njit(cache=True, nogil=True)
def point_to_point(
    table: CellTable,
    source: CellTable,
    cell: float,
    guess: FloatArray,
    radius_start: float,
    radius_end: float,
    max_iterations: int,
    mutual: bool,
) -> tuple[FloatArray, int, bool]:
    """The paper's registration from ``guess``: partners are the nearest (eq. 3) or, when ``mutual``, each
    the other's nearest (w_ij of eq. 25); each step is the closed form of eqs. 26-39. The search radius
    shrinks while it converges.

    Returns ref_T_src, iterations and whether it converged.
    """
    points, partners = source[3], table[3]
    d, m = np.empty((points.shape[0], 2)), np.empty((points.shape[0], 2))
    pose = guess.copy()
    radius = radius_start
    iteration = 0
    while iteration < max_iterations:
        iteration += 1
        c, s = math.cos(pose[2]), math.sin(pose[2])
        n = 0
        for i in range(points.shape[0]):
            x, y = (
                pose[0] + c * points[i, 0] - s * points[i, 1],
                pose[1] + s * points[i, 0] + c * points[i, 1],
            )
            q, _ = _nearest(table, cell, x, y, 0.0, 0.0, radius, 0.0)
            if q < 0:
                continue
            if mutual:
                rx, ry = partners[q, 0] - pose[0], partners[q, 1] - pose[1]
                back, _ = _nearest(source, cell, c * rx + s * ry, -s * rx + c * ry, 0.0, 0.0, radius, 0.0)
                if back != i:
                    continue
            d[n, 0], d[n, 1] = points[i, 0], points[i, 1]
            m[n, 0], m[n, 1] = partners[q, 0], partners[q, 1]
            n += 1
        if n < 2:
            break
        found = rigid_fit(d[:n], m[:n])
        moved = math.hypot(found[0] - pose[0], found[1] - pose[1])
        turned = abs(wrap_angle(found[2] - pose[2]))
        pose = found
        small = moved < 2e-4 and turned < 1e-4
        if small and radius <= radius_end:
            return pose, iteration, True
        if small or iteration >= 2:
            radius = max(radius_end, 0.6 * radius)
    return pose, iteration, False
