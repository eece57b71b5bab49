"""Pose graphs as g2o text, at full precision.

Information matrices are the upper triangle by rows: ``I11 I12 I13 I22 I23 I33``. Lines: ``VERTEX_SE2 id x y
theta``, ``FIX id``, ``EDGE_SE2 i j x y theta I...`` and, for factors on one pose, ``EDGE_PRIOR_SE2 i x y
theta I...``.
"""

from __future__ import annotations

import numpy as np

from mfslam.pose_graphs.data import GraphFile
from mfslam.types import Edge, FloatArray

_UPPER = np.triu_indices(3)


def graph_text(world_T_keyframe: FloatArray, edges: list[Edge]) -> str:
    """g2o text of keyframes (K, 3) and edges.

    Information is written as the final solve used it, scaled by each edge's weight, so that another
    optimiser finds the same map; edges that the solve rejected (weight 0) stay as comments.
    """
    poses = np.asarray(world_T_keyframe).tolist()
    used = [edge for edge in edges if edge.weight > 0]
    out = [f"VERTEX_SE2 {key} {_numbers(pose)}" for key, pose in enumerate(poses)]
    out += [_edge_line(edge, edge.weight * edge.information) for edge in used]
    # these come last: gtsam's reader loses the edges that follow a FIX or a comment
    if poses and not any(edge.kind == "prior" for edge in used):
        out.append("FIX 0")
    out += [f"# rejected: {_edge_line(edge, edge.information)}" for edge in edges if edge.weight <= 0]
    return "\n".join(out) + "\n"


def graph_file_text(graph: GraphFile, weights: FloatArray) -> str:
    """g2o text of a graph with weights (E,) of its edges, written as those of `graph_text`."""
    out = [
        f"VERTEX_SE2 {key} {_numbers(pose)}"
        for key, pose in zip(graph.ids.tolist(), graph.world_T_pose.tolist(), strict=True)
    ]
    upper = graph.information[:, _UPPER[0], _UPPER[1]]
    scaled = (upper * np.where(weights > 0, weights, 1.0)[:, None]).tolist()
    ends = zip(graph.i.tolist(), graph.j.tolist(), graph.i_T_j.tolist(), scaled, strict=True)
    lines = [f"{_head(i, j)} {_numbers(pose)} {_numbers(six)}" for i, j, pose, six in ends]
    used = (weights > 0).tolist()
    out += [line for line, keep in zip(lines, used, strict=True) if keep]
    out += [f"FIX {key}" for key in sorted(graph.fixed)]
    out += [f"# rejected: {line}" for line, keep in zip(lines, used, strict=True) if not keep]
    return "\n".join(out) + "\n"


def _edge_line(edge: Edge, information: FloatArray) -> str:
    return f"{_head(edge.i, edge.j)} {_numbers(edge.i_T_j.tolist())} {_numbers(information[_UPPER].tolist())}"


def _head(i: int, j: int) -> str:
    return f"EDGE_PRIOR_SE2 {i}" if i == j else f"EDGE_SE2 {i} {j}"


def _numbers(values: list[float]) -> str:
    return " ".join(f"{value:.17g}" for value in values)
