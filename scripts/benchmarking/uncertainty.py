"""What a run says of its own uncertainty, against ground-truth relations."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mfslam import se2
from mfslam.graph import GraphInformation
from mfslam.metrics import Relations
from mfslam.metrics.matching import nearest
from mfslam.output import read_graph, read_tum
from mfslam.types import Edge, FloatArray

MOST = 500  # relations that are looked at, evenly over the file


def against_relations(run: Path, relations: Relations, tolerance_s: float = 1e-5) -> dict[str, float] | None:
    """Root mean squares of stated and of actual errors of the relations, in m (along one axis) and deg, and the noise
    that the relations must have themselves for both to agree (mean chi2 per degree of freedom 1; 0 where what is
    stated is too much already). None for a run without a graph.

    The covariance of a relation is that of the keyframes nearest to its scans, from graph.g2o.
    """
    if not (run / "graph.g2o").is_file():
        return None
    stamps_ns, poses = read_tum(run / "trajectory.tum")
    keyframe_ns, world_T_keyframe = read_tum(run / "keyframes.tum")
    graph = read_graph(run / "graph.g2o")
    ends = zip(graph.i.tolist(), graph.j.tolist(), graph.i_T_j, graph.information, strict=True)
    edges = [Edge("scan", i, j, pose, information) for i, j, pose, information in ends]
    a, a_found = nearest(stamps_ns, relations.a_ns, tolerance_s)
    b, b_found = nearest(stamps_ns, relations.b_ns, tolerance_s)
    known = np.flatnonzero(a_found & b_found)
    known = known[np.linspace(0, len(known) - 1, min(MOST, len(known))).astype(np.int64)]
    a, b = a[known], b[known]
    of_a, of_b = (nearest(keyframe_ns, stamps_ns[scans], 1e9)[0] for scans in (a, b))
    apart = of_a != of_b
    a, b, of_a, of_b, known = a[apart], b[apart], of_a[apart], of_b[apart], known[apart]
    if not len(known):
        return None
    error = se2.log(se2.between(se2.between(poses[a], poses[b]), relations.a_T_b[known]))
    variances = np.diagonal(
        GraphInformation(world_T_keyframe, edges).relative_covariances(of_a, of_b), axis1=1, axis2=2
    )
    return {
        "stated_m": float(np.sqrt(variances[:, :2].mean())),
        "error_m": float(np.sqrt(np.square(error[:, :2]).mean())),
        "relation_sigma_m": missing_sigma(error[:, :2].ravel(), variances[:, :2].ravel()),
        "stated_deg": float(np.degrees(np.sqrt(variances[:, 2].mean()))),
        "error_deg": float(np.degrees(np.sqrt(np.square(error[:, 2]).mean()))),
        "relation_sigma_deg": float(np.degrees(missing_sigma(error[:, 2], variances[:, 2]))),
    }


def missing_sigma(errors: FloatArray, variances: FloatArray) -> float:
    """Sigma of further noise with which errors (N,) have the mean chi2 of 1; gross errors, beyond five times the
    median, say nothing of noise and are left out."""
    typical = np.abs(errors) <= 5.0 * np.median(np.abs(errors))
    squares, variances = np.square(errors[typical]), variances[typical]
    low, high = 0.0, float(squares.max())
    for _ in range(60):
        middle = 0.5 * (low + high)
        too_small = np.mean(squares / np.maximum(variances + middle, 1e-18)) > 1.0
        low, high = (middle, high) if too_small else (low, middle)
    return float(np.sqrt(low))
