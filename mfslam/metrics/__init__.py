"""How good a trajectory or a map is: relations error, ATE, RPE, drift, NEES, crispness."""

from mfslam.metrics.bootstrap import Difference, paired_bootstrap
from mfslam.metrics.crispness import Crispness, crispness
from mfslam.metrics.drift import Drift, drift
from mfslam.metrics.matching import associate
from mfslam.metrics.nees import Nees, nees
from mfslam.metrics.poses import Alignment, PoseError, absolute_errors, align, ate, rpe
from mfslam.metrics.relations import (
    Relations,
    RelationsError,
    read_relations,
    relation_errors,
    relations_error,
)
from mfslam.metrics.sharpness import Sharpness, compare_motions
from mfslam.metrics.statistics import ErrorStats

__all__ = [
    "Alignment",
    "Crispness",
    "Difference",
    "Drift",
    "ErrorStats",
    "Nees",
    "PoseError",
    "Relations",
    "RelationsError",
    "Sharpness",
    "absolute_errors",
    "align",
    "associate",
    "ate",
    "compare_motions",
    "crispness",
    "drift",
    "nees",
    "paired_bootstrap",
    "read_relations",
    "relation_errors",
    "relations_error",
    "rpe",
]
