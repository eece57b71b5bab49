"""What gtsam solves: the graph of a run's keyframes."""

from mfslam.graph.keyframe_graph import PRIOR_SIGMAS, SETTLED, PoseGraph

__all__ = ["PRIOR_SIGMAS", "SETTLED", "PoseGraph"]
