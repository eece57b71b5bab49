"""Motion-free ICP: registration of deskewed scans, with an information matrix that is honest."""

from __future__ import annotations

import math

import numpy as np

from mfslam import se2
from mfslam.config import IcpConfig
from mfslam.kernels import align, align_moving, cells, matrices
from mfslam.kernels.cells import CellTable
from mfslam.types import DeskewedScan, FloatArray, Match

CELL_M = 0.25
NO_PRIOR = np.zeros((3, 3))
FREE = np.full(3, np.inf)  # sigmas of a pose of which nothing is known


def reference_table(oriented: FloatArray) -> CellTable:
    """Search structure over oriented points (M, 4): x, y, nx, ny."""
    table: CellTable = cells.build_cells(oriented, CELL_M)
    return table


def register(
    reference: CellTable,
    points_m: FloatArray,
    normals: FloatArray,
    guess: FloatArray,
    range_sigma_m: float,
    config: IcpConfig,
    prior: FloatArray | None = None,
    prior_sigmas: FloatArray = FREE,
    search_radius_m: float | None = None,
    prior_information: FloatArray | None = None,
) -> Match:
    """Where the source stands in the reference.

    ``points_m``, ``normals`` (M, 2): the source. ``guess`` (3,): ref_T_src to start from. A ``prior`` (3,; else the guess)
    with ``prior_sigmas`` (3,) in its tangent, or ``prior_information`` (3, 3), keeps directions in place that the scans
    do not constrain; it moves the estimate but is not part of the information returned. The information is that of the point-to-line
    residuals at the solution whatever the method: points that slide along a wall say nothing of it.
    """
    sigma = math.sqrt(2.0) * range_sigma_m  # both ends of a residual are measured
    held = guess if prior is None else prior
    radius_m = config.search_radius_m if search_radius_m is None else search_radius_m
    honest = config.independent_share, config.sigma_floor_m, config.sigma_floor_rad
    if prior_information is None:
        prior_information = matrices.of_sigmas(prior_sigmas)
    if config.method == "point_to_line":
        return Match(
            *align.point_to_line_match(
                reference, CELL_M, points_m, normals, guess, held, prior_information, sigma, config.kernel_sigmas, radius_m,
                config.final_radius_m, config.max_iterations, config.open_share, *honest,
            )
        )  # fmt: skip
    pose, hessian, inlier_ratio, rms_m, iterations, converged = _closed_form(
        reference, points_m, normals, guess, sigma, radius_m, config
    )
    information = align.honest_information(hessian, sigma, rms_m, *honest)
    if prior_information.any():
        pose = _merged(pose, information, held, prior_information)
    return Match(pose, information, inlier_ratio, rms_m, iterations, converged)


def register_moving(
    reference: CellTable,
    cloud: DeskewedScan,
    times_s: FloatArray,
    guess: FloatArray,
    prior_pose: FloatArray,
    prior_change: FloatArray,
    prior_information: FloatArray,
    range_sigma_m: float,
    config: IcpConfig,
) -> tuple[FloatArray, FloatArray]:
    """Where a scan stands in the reference (3,), and how the twist that it was deskewed with has to change
    (3,): both at once, from the distortion that is left in the scan.

    ``times_s`` (M,): instants of the cloud's points from its reference instant. ``prior_information``
    (6, 6) of pose and change about ``prior_pose`` and ``prior_change`` (3,).
    """
    pose, change, converged = align_moving.point_to_line_moving(
        reference, CELL_M, cloud.points_m, cloud.normals, times_s, guess,
        np.concatenate([prior_pose, prior_change]), config.independent_share**-1 * prior_information,
        math.sqrt(2.0) * range_sigma_m, config.kernel_sigmas, 0.5 * config.search_radius_m,
        config.final_radius_m, config.max_iterations, config.open_share,
    )  # fmt: skip
    return (pose, change) if converged else (guess, np.zeros(3))


def _closed_form(
    reference: CellTable,
    points_m: FloatArray,
    normals: FloatArray,
    guess: FloatArray,
    sigma: float,
    search_radius_m: float,
    config: IcpConfig,
) -> tuple[FloatArray, FloatArray, float, float, int, bool]:
    """The paper's point-to-point registration (eqs. 25-39), with the point-to-line information there."""
    source = reference_table(np.hstack([points_m, normals]))
    pose, iterations, converged = align.point_to_point(
        reference, source, CELL_M, guess, search_radius_m, config.final_radius_m, config.max_iterations,
        config.partners == "mutual",
    )  # fmt: skip
    # one evaluation of the point-to-line residuals; its step is not taken
    _, hessian, inlier_ratio, rms_m, _, _ = align.point_to_line(
        reference, CELL_M, points_m, normals, pose, pose, NO_PRIOR, sigma,
        config.kernel_sigmas, config.final_radius_m, config.final_radius_m, 1, config.open_share,
    )  # fmt: skip
    return pose, hessian, inlier_ratio, rms_m, iterations, converged


def _merged(
    pose: FloatArray, information: FloatArray, prior: FloatArray, prior_information: FloatArray
) -> FloatArray:
    """Two estimates of one pose, each weighing as much as its information: the closed form knows no prior."""
    pull = prior_information @ se2.log(se2.between(pose, prior))
    step: FloatArray = np.asarray(np.linalg.lstsq(information + prior_information, pull, rcond=None)[0])
    return se2.compose(pose, se2.exp(step))


def with_floor(information: FloatArray, sigma_m: float, sigma_rad: float) -> FloatArray:
    """Information after an independent error is added to the covariance: (H^-1 + F)^-1, written so that
    a singular H stays singular in the same direction."""
    out: FloatArray = matrices.add_error(information, sigma_m**2, sigma_rad**2)
    return out
