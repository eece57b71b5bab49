"""Registration of a scan together with the motion through it: point to line, pose and twist at once."""

import math

import numpy as np

from mfslam.kernels.align import MIN_NORMAL_COS, error_from, geman_mcclure, line_residual, step_by
from mfslam.kernels.cells import CellTable
from mfslam.kernels.compiling import helper, kernel
from mfslam.kernels.matrices import cholesky_root, open_direction, solve_by_root
from mfslam.kernels.partners import find_partners, nothing_known
from mfslam.kernels.poses import arc, wrap_angle
from mfslam.types import FloatArray, IntArray


@helper
def _drop_direction(h: FloatArray, b: FloatArray, v0: float, v1: float) -> None:
    """Take the direction (v0, v1) of translation out of the equations of pose and twist (6, 6), (6,)."""
    for first in (0, 3):
        along = v0 * b[first] + v1 * b[first + 1]
        b[first] -= along * v0
        b[first + 1] -= along * v1
        for k in range(6):
            along = v0 * h[first, k] + v1 * h[first + 1, k]
            h[first, k] -= along * v0
            h[first + 1, k] -= along * v1
    for first in (0, 3):
        for k in range(6):
            along = v0 * h[k, first] + v1 * h[k, first + 1]
            h[k, first] -= along * v0
            h[k, first + 1] -= along * v1


@helper
def _place_moving(
    points: FloatArray,
    normals: FloatArray,
    times: FloatArray,
    pose: FloatArray,
    change: FloatArray,
    body: FloatArray,
    placed: FloatArray,
) -> None:
    """Fill ``placed`` and ``body`` (M, 4) with points and normals by a pose and a change of the twist, in the
    reference's frame and in the scan's own."""
    for i in range(points.shape[0]):
        x, y, turn = arc(change[0] * times[i], change[1] * times[i], change[2] * times[i])
        c, s = math.cos(turn), math.sin(turn)
        body[i, 0] = x + c * points[i, 0] - s * points[i, 1]
        body[i, 1] = y + s * points[i, 0] + c * points[i, 1]
        body[i, 2] = c * normals[i, 0] - s * normals[i, 1]
        body[i, 3] = s * normals[i, 0] + c * normals[i, 1]
    c, s = math.cos(pose[2]), math.sin(pose[2])
    for i in range(points.shape[0]):
        placed[i, 0] = pose[0] + c * body[i, 0] - s * body[i, 1]
        placed[i, 1] = pose[1] + s * body[i, 0] + c * body[i, 1]
        placed[i, 2] = c * body[i, 2] - s * body[i, 3]
        placed[i, 3] = s * body[i, 2] + c * body[i, 3]


@helper
def _normal_equations(
    rows: FloatArray,
    partner: IntArray,
    body: FloatArray,
    placed: FloatArray,
    times: FloatArray,
    pose: FloatArray,
    sigma: float,
    scale: float,
    radius: float,
    h: FloatArray,
    b: FloatArray,
) -> None:
    """Fill h (6, 6) and b (6,) of all residuals of points that `_place_moving` has placed."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    inv_s2 = 1.0 / (sigma * sigma)
    jacobian = np.empty(3)
    for u in range(6):
        b[u] = 0.0
        for v in range(6):
            h[u, v] = 0.0
    for i in range(placed.shape[0]):
        pair, nx, ny, r = line_residual(
            rows, partner[i], placed[i, 0], placed[i, 1], placed[i, 2], placed[i, 3], radius
        )
        if pair <= 0:
            continue
        jacobian[0], jacobian[1] = c * nx + s * ny, -s * nx + c * ny
        jacobian[2] = jacobian[1] * body[i, 0] - jacobian[0] * body[i, 1]
        t = times[i]
        wi = geman_mcclure(r, scale) * inv_s2
        for u in range(3):
            b[u] -= wi * jacobian[u] * r
            b[3 + u] -= wi * t * jacobian[u] * r
            for v in range(u + 1):
                product = wi * jacobian[u] * jacobian[v]
                h[u, v] += product
                h[3 + u, v] += t * product
                h[3 + u, 3 + v] += t * t * product
    for u in range(3):
        for v in range(u + 1):
            h[3 + v, u] = h[3 + u, v]
    for u in range(6):
        for v in range(u):
            h[v, u] = h[u, v]


@kernel
def point_to_line_moving(
    table: CellTable,
    cell: float,
    points: FloatArray,
    normals: FloatArray,
    times: FloatArray,
    guess: FloatArray,
    prior: FloatArray,
    prior_information: FloatArray,
    sigma: float,
    kernel_sigmas: float,
    radius_start: float,
    radius_end: float,
    max_iterations: int,
    open_share: float,
) -> tuple[FloatArray, FloatArray, bool]:
    """Robust point-to-line registration of a scan whose deskewing is not settled.

    A point (M, 2), deskewed so far with some twist, stands at exp(change t) p in the scan's frame, t (M,)
    being the time of its beam from the reference instant. ref_T_src and the ``change`` of the twist (3,)
    minimise sum rho(n . (T exp(change t) p - q)) / sigma^2 plus the square of the error from ``prior`` (6,), a
    pose and a change of twist, weighted by ``prior_information`` (6, 6): Gauss-Newton, Jacobians of the twist
    being t times those of the pose.
    Returns ref_T_src, the change of twist, and whether it converged.
    """
    pose, change = guess.copy(), np.zeros(3)
    h, root, b, error = np.empty((6, 6)), np.empty((6, 6)), np.empty(6), np.empty(6)
    index, rows = table
    body, placed = np.empty((points.shape[0], 4)), np.empty((points.shape[0], 4))
    partner, seen = nothing_known(points.shape[0])
    radius = radius_start
    converged = False
    for iteration in range(max_iterations):
        scale = max(kernel_sigmas * sigma, 0.25 * radius)
        _place_moving(points, normals, times, pose, change, body, placed)
        find_partners(index, rows, cell, placed, radius, MIN_NORMAL_COS, partner, seen)
        _normal_equations(rows, partner, body, placed, times, pose, sigma, scale, radius, h, b)
        is_open, v0, v1 = open_direction(h, open_share)
        if is_open:  # what noise feigns along an open direction must not pull against the prior
            _drop_direction(h, b, v0, v1)
        error[0], error[1], error[2] = error_from(prior, pose)
        for u in range(3):
            error[3 + u] = prior[3 + u] - change[u]
        for u in range(6):
            for v in range(6):
                h[u, v] += prior_information[u, v]
                b[u] += prior_information[u, v] * error[v]
        if not cholesky_root(h, root):
            break
        solve_by_root(root, b)
        small = step_by(pose, b[0], b[1], b[2])
        for u in range(3):
            change[u] += b[3 + u]
        if small and radius <= radius_end:
            converged = True
            break
        if small or iteration >= 1:
            radius = max(radius_end, 0.6 * radius)
    pose[2] = wrap_angle(pose[2])
    return pose, change, converged
