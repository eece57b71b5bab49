"""What gtsam solves: the graph of a run's keyframes; and how sure the solution is."""

from mfslam.graph.keyframe_graph import PRIOR_SIGMAS, SETTLED, PoseGraph
from mfslam.graph.marginals import GraphInformation, scan_covariances

__all__ = ["PRIOR_SIGMAS", "SETTLED", "GraphInformation", "PoseGraph", "scan_covariances"]
