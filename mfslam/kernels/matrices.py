"""Information matrices (3, 3) in compiled code."""

import math

import numpy as np

from mfslam.kernels.compiling import helper, kernel
from mfslam.types import FloatArray


@kernel
def add_error(information: FloatArray, var_xy: float, var_turn: float) -> FloatArray:
    """Information (3, 3) after an independent error is added to the covariance: (H^-1 + F)^-1, written
    H (I + F H)^-1 so that a singular H stays singular in the same direction."""
    a = np.empty((3, 3))
    for u in range(3):
        f = var_turn if u == 2 else var_xy
        for v in range(3):
            a[u, v] = f * information[u, v] + (1.0 if u == v else 0.0)
    inverse = np.empty((3, 3))
    for u in range(3):
        u1, u2 = (u + 1) % 3, (u + 2) % 3
        for v in range(3):
            v1, v2 = (v + 1) % 3, (v + 2) % 3
            inverse[v, u] = a[u1, v1] * a[u2, v2] - a[u1, v2] * a[u2, v1]
    det = a[0, 0] * inverse[0, 0] + a[0, 1] * inverse[1, 0] + a[0, 2] * inverse[2, 0]
    out = np.empty((3, 3))
    for u in range(3):
        for v in range(3):
            out[u, v] = (
                information[u, 0] * inverse[0, v]
                + information[u, 1] * inverse[1, v]
                + information[u, 2] * inverse[2, v]
            ) / det
    for u in range(3):
        for v in range(u):
            out[u, v] = out[v, u] = 0.5 * (out[u, v] + out[v, u])
    return out


@kernel
def of_sigmas(sigmas: FloatArray) -> FloatArray:
    """Information (3, 3) of independent errors with ``sigmas`` (3,): none where one is infinite."""
    information = np.zeros((3, 3))
    for d in range(3):
        information[d, d] = sigmas[d] ** -2
    return information


@kernel
def upper_root(information: FloatArray, absolute_floor: float, relative_floor: float) -> FloatArray:
    """Upper triangular R with R^T R = H + e I, by Cholesky; e the larger of both floors (the relative one
    times the trace of H). Not a number where H is not finite or not positive semidefinite."""
    trace = information[0, 0] + information[1, 1] + information[2, 2]
    floor = max(absolute_floor, relative_floor * trace)
    root = np.zeros((3, 3))
    for u in range(3):
        for v in range(u, 3):
            rest = 0.5 * (information[u, v] + information[v, u])
            if u == v:
                rest += floor
            for k in range(u):
                rest -= root[k, u] * root[k, v]
            if u == v:
                root[u, u] = math.sqrt(rest) if rest > 0.0 else math.nan
            else:
                root[u, v] = rest / root[u, u]
    return root


@kernel
def open_direction(information: FloatArray, least_share: float) -> tuple[bool, float, float]:
    """Whether a direction of translation (the first two rows) holds less than ``least_share`` of the information of the one
    across it, and that direction (unit vector).

    Along a bare corridor the true information is none, but normals that are not quite exact feign some
    tenths of a percent of that across it.
    """
    a, b, d = information[0, 0], information[0, 1], information[1, 1]
    root = math.sqrt(0.25 * (a - d) * (a - d) + b * b)
    strong, weak = 0.5 * (a + d) + root, 0.5 * (a + d) - root
    # the weak eigenvector stands across the strong one
    angle = 0.5 * math.atan2(2.0 * b, a - d) + 0.5 * math.pi
    return weak < least_share * strong, math.cos(angle), math.sin(angle)


@kernel
def drop_open_direction(information: FloatArray, least_share: float) -> FloatArray:
    """Information (3, 3) without what noise feigns along an open direction: nothing of it is left."""
    is_open, v0, v1 = open_direction(information, least_share)
    if not is_open:
        return information.copy()
    a, b, d = information[0, 0], information[0, 1], information[1, 1]
    p00, p01, p11 = 1.0 - v0 * v0, -v0 * v1, 1.0 - v1 * v1
    out = np.empty((3, 3))
    out[2, 2] = information[2, 2]
    # P H P with P = I - v v^T on the translation
    h00, h01 = p00 * a + p01 * b, p00 * b + p01 * d
    h10, h11 = p01 * a + p11 * b, p01 * b + p11 * d
    out[0, 0], out[1, 1] = h00 * p00 + h01 * p01, h10 * p01 + h11 * p11
    out[0, 1] = out[1, 0] = h00 * p01 + h01 * p11
    out[0, 2] = out[2, 0] = p00 * information[0, 2] + p01 * information[1, 2]
    out[1, 2] = out[2, 1] = p01 * information[0, 2] + p11 * information[1, 2]
    return out


@helper
def cholesky_root(a: FloatArray, root: FloatArray) -> bool:
    """Lower triangular R of R R^T = a (N, N), in ``root``, above whose diagonal nothing is touched; False where ``a`` is
    not positive definite."""
    for u in range(a.shape[0]):
        for v in range(u + 1):
            rest = a[u, v]
            for k in range(v):
                rest -= root[u, k] * root[v, k]
            if u > v:
                root[u, v] = rest / root[v, v]
            elif rest > 0.0:
                root[u, u] = math.sqrt(rest)
            else:
                return False
    return True


@helper
def solve_by_root(root: FloatArray, x: FloatArray) -> None:
    """The solution of R R^T y = x in place of ``x`` (N,)."""
    n = x.shape[0]
    for u in range(n):
        for k in range(u):
            x[u] -= root[u, k] * x[k]
        x[u] /= root[u, u]
    for u in range(n - 1, -1, -1):
        for k in range(u + 1, n):
            x[u] -= root[k, u] * x[k]
        x[u] /= root[u, u]
