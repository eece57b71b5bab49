"""Joint adjustment: all keyframes, the walls that they saw and the wheels' errors, at once."""

from mfslam.adjustment.adjust import Adjusted, adjust
from mfslam.adjustment.marginals import AdjustedInformation
from mfslam.adjustment.noise import Noise
from mfslam.adjustment.points import ScanPoints
from mfslam.adjustment.wheels import WheelTerms

__all__ = ["Adjusted", "AdjustedInformation", "Noise", "ScanPoints", "WheelTerms", "adjust"]
