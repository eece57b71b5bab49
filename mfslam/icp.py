"""Motion-free ICP: registration of deskewed scans, with an information matrix that is honest."""

from __future__ import annotations

import numpy as np

from mfslam.config import IcpConfig
from mfslam.kernels import align, cells
from mfslam.kernels.cells import CellTable
from mfslam.types import FloatArray, Match

CELL_M = 0.25
NO_PRIOR = np.zeros((3, 3))


def reference_table(oriented: FloatArray) -> CellTable:
    """Search structure over oriented points (M, 4): x, y, nx, ny."""
    return cells.build_cells(oriented, CELL_M)


def register(
    reference: CellTable,
    points_m: FloatArray,
    normals: FloatArray,
    guess: FloatArray,
    range_sigma_m: float,
    config: IcpConfig,
    prior: FloatArray | None = None,
    prior_information: FloatArray | None = None,
    search_radius_m: float | None = None,
) -> Match:
    """Where the source stands in the reference.

    ``points_m``, ``normals`` (M, 2): the source. ``guess`` (3,): ref_T_src to start from. A ``prior``
    with its information keeps directions in place that the scans do not constrain; it moves the
    estimate but is not part of the information returned.
    """
    sigma = np.sqrt(2.0) * range_sigma_m  # both ends of a residual are measured
    pose, hessian, inlier_ratio, rms_m, iterations, converged = align.point_to_line(
        reference,
        CELL_M,
        points_m,
        normals,
        guess,
        guess if prior is None else prior,
        NO_PRIOR if prior_information is None else prior_information,
        sigma,
        config.kernel_sigmas,
        config.search_radius_m if search_radius_m is None else search_radius_m,
        config.final_radius_m,
        config.max_iterations,
    )
    # residuals above the model's sigma (quantisation, rough walls) take information away
    scale = config.independent_share * min(1.0, (sigma / max(rms_m, 1e-9)) ** 2)
    return Match(
        ref_T_src=pose,
        information=with_floor(scale * hessian, config.sigma_floor_m, np.deg2rad(config.sigma_floor_deg)),
        inlier_ratio=inlier_ratio,
        rms_m=rms_m,
        iterations=iterations,
        converged=converged,
    )


def with_floor(information: FloatArray, sigma_m: float, sigma_rad: float) -> FloatArray:
    """Information after an independent error is added to the covariance: (H^-1 + F)^-1, written so that
    a singular H stays singular in the same direction."""
    floor = np.diag([sigma_m**2, sigma_m**2, sigma_rad**2])
    out = np.linalg.solve((np.eye(3) + floor @ information).T, information.T).T
    return np.asarray(0.5 * (out + out.T))
