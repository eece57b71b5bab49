"""Information matrices (3, 3) in compiled code."""

import math

import numpy as np
from numba import njit

from mfslam.types import FloatArray


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
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
