"""Iterations of registration: point-to-line (Gauss-Newton) and point-to-point (closed form)."""

import math

import numpy as np

from mfslam.kernels.cells import CellTable
from mfslam.kernels.compiling import helper, kernel
from mfslam.kernels.matrices import add_error, drop_open_direction, open_direction
from mfslam.kernels.partners import find_partners, nothing_known
from mfslam.kernels.poses import transform_points, wrap_angle
from mfslam.types import FloatArray, IntArray

MIN_NORMAL_COS = 0.7  # partners face the same way within 45 deg


@helper
def line_residual(
    rows: FloatArray, q: int, x: float, y: float, own_x: float, own_y: float, radius: float
) -> tuple[int, float, float, float]:
    """Of a point, its own normal and row ``q`` of its partner: 1, the normal of the partner's line and the
    distance from it; 0 where neither of the two has a normal; -1 without a partner within ``radius``."""
    if q < 0:
        return -1, 0.0, 0.0, 0.0
    dx, dy = x - rows[q, 0], y - rows[q, 1]
    if dx * dx + dy * dy >= radius * radius:
        return -1, 0.0, 0.0, 0.0
    nx, ny = rows[q, 2], rows[q, 3]
    if nx == 0.0 and ny == 0.0:
        nx, ny = own_x, own_y
    if nx == 0.0 and ny == 0.0:
        return 0, 0.0, 0.0, 0.0
    return 1, nx, ny, nx * dx + ny * dy


@helper
def geman_mcclure(r: float, scale: float) -> float:
    """Weight of a residual."""
    w = scale * scale / (scale * scale + r * r)
    return w * w


@helper
def error_from(prior: FloatArray, pose: FloatArray) -> tuple[float, float, float]:
    """From a pose to a prior near it, in the frame of the pose."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    ex, ey = prior[0] - pose[0], prior[1] - pose[1]
    return c * ex + s * ey, -s * ex + c * ey, wrap_angle(prior[2] - pose[2])


@helper
def step_by(pose: FloatArray, dx: float, dy: float, turn: float) -> bool:
    """Move a pose in its own frame, in place; whether that was next to nothing."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    pose[0] += c * dx - s * dy
    pose[1] += s * dx + c * dy
    pose[2] += turn
    return abs(dx) + abs(dy) < 2e-4 and abs(turn) < 1e-4


@helper
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


@helper
def _normal_equations(
    rows: FloatArray,
    partner: IntArray,
    points: FloatArray,
    placed: FloatArray,
    pose: FloatArray,
    sigma: float,
    scale: float,
    radius: float,
    h: FloatArray,
) -> tuple[float, float, float, float, float, int]:
    """Fill the information ``h`` (3, 3) of all point-to-line residuals of the points, ``placed`` by ``pose``.

    Returns the right-hand side b0, b1, b2 of h d = b, the sums of weighted squares and of weights, and the
    number of pairs without any normal.
    """
    c, s = math.cos(pose[2]), math.sin(pose[2])
    inv_s2 = 1.0 / (sigma * sigma)
    for u in range(3):  # not h[:] = 0.0: whole arrays at once take a second to compile
        for v in range(3):
            h[u, v] = 0.0
    b0 = b1 = b2 = 0.0
    sum_r2 = 0.0
    weight_sum = 0.0
    mute = 0
    for i in range(points.shape[0]):
        px, py = points[i, 0], points[i, 1]
        pair, nx, ny, r = line_residual(
            rows, partner[i], placed[i, 0], placed[i, 1], placed[i, 2], placed[i, 3], radius
        )
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


@kernel
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
    index, rows = table
    placed = np.empty((points.shape[0], 4))
    partner, seen = nothing_known(points.shape[0])
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
        transform_points(pose, points, normals, placed)
        find_partners(index, rows, cell, placed, radius, MIN_NORMAL_COS, partner, seen)
        b0, b1, b2, sum_r2, weight_sum, mute = _normal_equations(
            rows, partner, points, placed, pose, sigma, scale, radius, h
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


@kernel
def honest_information(
    hessian: FloatArray,
    sigma: float,
    rms_m: float,
    independent_share: float,
    floor_m: float,
    floor_rad: float,
) -> FloatArray:
    """Information (3, 3) of a match from that of its residuals: ``independent_share`` of the beams count, residuals above
    the model's ``sigma`` (quantisation, rough walls) take of it, and no match is better than the floors."""
    scale = independent_share * min(1.0, (sigma / max(rms_m, 1e-9)) ** 2)
    scaled = np.empty((3, 3))
    for u in range(3):
        for v in range(3):
            scaled[u, v] = scale * hessian[u, v]
    out: FloatArray = add_error(scaled, floor_m * floor_m, floor_rad * floor_rad)
    return out


@kernel
def point_to_line_match(
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
    open_share: float,
    independent_share: float,
    floor_m: float,
    floor_rad: float,
) -> tuple[FloatArray, FloatArray, float, float, int, bool]:
    """`point_to_line`, with the `honest_information` of what it found."""
    pose, hessian, inlier_ratio, rms_m, iterations, converged = point_to_line(
        table, cell, points, normals, guess, prior, prior_information, sigma, kernel_sigmas, radius_start, radius_end,
        max_iterations, open_share,
    )  # fmt: skip
    information = honest_information(hessian, sigma, rms_m, independent_share, floor_m, floor_rad)
    return pose, information, inlier_ratio, rms_m, iterations, converged


@kernel
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


@kernel
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
    index, rows = table
    source_index, points = source
    count = points.shape[0]
    d, m = np.empty((count, 2)), np.empty((count, 2))
    placed, partner_placed = np.zeros((count, 4)), np.zeros((count, 4))  # without normals
    partner, seen = nothing_known(count)
    back, back_seen = nothing_known(count)
    pose = guess.copy()
    radius = radius_start
    iteration = 0
    while iteration < max_iterations:
        iteration += 1
        c, s = math.cos(pose[2]), math.sin(pose[2])
        for i in range(count):
            placed[i, 0] = pose[0] + c * points[i, 0] - s * points[i, 1]
            placed[i, 1] = pose[1] + s * points[i, 0] + c * points[i, 1]
        find_partners(index, rows, cell, placed, radius, 0.0, partner, seen)
        if mutual:
            for i in range(count):
                if partner[i] >= 0:
                    rx, ry = rows[partner[i], 0] - pose[0], rows[partner[i], 1] - pose[1]
                    partner_placed[i, 0], partner_placed[i, 1] = c * rx + s * ry, -s * rx + c * ry
            find_partners(source_index, points, cell, partner_placed, radius, 0.0, back, back_seen)
        n = 0
        for i in range(count):
            q = partner[i]
            if q < 0 or math.hypot(rows[q, 0] - placed[i, 0], rows[q, 1] - placed[i, 1]) >= radius:
                continue
            if mutual and back[i] != i:
                continue
            d[n, 0], d[n, 1] = points[i, 0], points[i, 1]
            m[n, 0], m[n, 1] = rows[q, 0], rows[q, 1]
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
