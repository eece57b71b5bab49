"""The graph of a run's keyframes, how it is solved, and how sure the solution is; gtsam for graphs from files."""

from mfslam.graph.keyframe_graph import PoseGraph
from mfslam.graph.marginals import GraphInformation, scan_covariances

__all__ = ["GraphInformation", "PoseGraph", "scan_covariances"]
