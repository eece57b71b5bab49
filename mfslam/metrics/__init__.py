"""How good a trajectory or a map is: relations error, ATE, RPE, crispness."""

from mfslam.metrics.crispness import Crispness, crispness
from mfslam.metrics.matching import associate
from mfslam.metrics.poses import Alignment, PoseError, align, ate, rpe
from mfslam.metrics.relations import Relations, RelationsError, read_relations, relations_error
from mfslam.metrics.sharpness import Sharpness, compare_motions
from mfslam.metrics.statistics import ErrorStats

__all__ = [
    "Alignment",
    "Crispness",
    "ErrorStats",
    "PoseError",
    "Relations",
    "RelationsError",
    "Sharpness",
    "align",
    "associate",
    "ate",
    "compare_motions",
    "crispness",
    "read_relations",
    "relations_error",
    "rpe",
]
