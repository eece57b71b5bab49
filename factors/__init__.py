"""Measurements into native gtsam factors and noise models; one file each, its residual at the top."""

from factors.heading import compass_factor, gyro_factor
from factors.noise import noise_from_information, robust_noise
from factors.prior import prior_factor
from factors.scan_match import scan_match_factor
from factors.wheel_odometry import wheel_odometry_factor

__all__ = [
    "compass_factor",
    "gyro_factor",
    "noise_from_information",
    "prior_factor",
    "robust_noise",
    "scan_match_factor",
    "wheel_odometry_factor",
]
