"""How noisy ranges and walls are, as what the adjustment leaves of the points shows."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mfslam.types import Float32Array, Int32Array

MIN_SCANS = 5  # that saw a patch, for it to tell of their noise
MIN_POINTS = 3.0  # of a scan on a patch, for their mean to tell where it stands
MEDIAN_CHI2 = 0.455  # of a squared normal error
LEAST_SIGMA_M, LARGEST_SIGMA_M = 0.001, 0.05
FAR_OFF = 97.0  # per cent of all groups lie nearer to their patch than those that are far off
PRIOR_POINTS = 100.0  # that the configured noise of a range counts as


@dataclass(frozen=True)
class Noise:
    """``range_sigma_m``: of one range. ``patch_sigma_m``: what the points of a scan on one patch have in common:
    rough walls, a motion within the scan that is not quite right."""

    range_sigma_m: float
    patch_sigma_m: float


@dataclass(frozen=True, eq=False)
class Residuals:
    """Of each group its patch (M,) and the last four of its sums (M, 4): see `wall_patches.group_sums`."""

    patch_of: Int32Array
    sums: Float32Array
    patch_count: int


def far_off_m(residuals: Residuals) -> float:
    """How far scans that are far off stand from the patches that they saw, by the means of their points; 0 where none
    was seen by several."""
    seen_by = np.bincount(residuals.patch_of, minlength=residuals.patch_count)
    told = (seen_by[residuals.patch_of] >= MIN_SCANS) & (residuals.sums[:, 0] >= MIN_POINTS)
    if not told.any():
        return 0.0
    patch_of, (size, total) = residuals.patch_of[told], residuals.sums[told, :2].T.astype(np.float64)
    totals, sizes = (np.bincount(patch_of, each, residuals.patch_count) for each in (total, size))
    return float(np.percentile(np.abs(total / size - totals[patch_of] / sizes[patch_of]), FAR_OFF))


def noise_found(residuals: Residuals, scan_count: int, noise: Noise, kernel_m: float) -> Noise:
    """The noise that the residuals show, under a kernel of scale ``kernel_m``: of ranges within the groups, of patches
    between them."""
    patch_of, patch_count = residuals.patch_of, residuals.patch_count
    seen_by = np.bincount(patch_of, minlength=patch_count)
    size, total, squares, slant = residuals.sums[seen_by[patch_of] >= MIN_SCANS].T
    if not len(size):
        return noise
    within = size > 1.5
    free = np.sum((slant * (1.0 - 1.0 / np.maximum(size, 1.0)))[within])
    spread = np.sum((squares - total**2 / size)[within])
    whole = math.hypot(noise.range_sigma_m, noise.patch_sigma_m)
    for _ in range(5):  # the kernel makes what is left look smaller, by how much depends on how large it is
        spread_of_all = spread / _kept_by_kernel(kernel_m / whole)
        range_variance = (PRIOR_POINTS * noise.range_sigma_m**2 + spread_of_all) / (PRIOR_POINTS + free)
        whole = math.sqrt(range_variance + noise.patch_sigma_m**2)
    mean = total / size
    left = 1.0 - (3.0 * scan_count + 2.0 * patch_count) / max(len(patch_of), 1)
    low, high = LEAST_SIGMA_M, LARGEST_SIGMA_M
    for _ in range(20):
        middle = 0.5 * (low + high)
        chi2 = np.median(mean**2 / (range_variance * slant / size**2 + middle**2))
        low, high = (middle, high) if chi2 > MEDIAN_CHI2 * max(left, 0.1) else (low, middle)
    return Noise(float(np.sqrt(range_variance)), float(high))


def _kept_by_kernel(scale_sigmas: float) -> float:
    """Variance of normal errors under the weights of a Geman-McClure kernel, over their variance."""
    x = np.linspace(0.0, 6.0, 601)
    weight = (scale_sigmas**2 / (scale_sigmas**2 + x**2)) ** 2 * np.exp(-0.5 * x**2)
    return float(np.sum(weight * x**2) / np.sum(weight))
