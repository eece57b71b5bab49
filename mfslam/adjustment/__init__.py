"""Joint adjustment: all keyframes, the walls that they saw and the wheels' errors, at once."""

from mfslam.adjustment.adjust import Adjusted, Noise, adjust
from mfslam.adjustment.marginals import AdjustedInformation
from mfslam.adjustment.wheels import WheelTerms

__all__ = ["Adjusted", "AdjustedInformation", "Noise", "WheelTerms", "adjust"]
