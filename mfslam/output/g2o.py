"""Pose graphs in g2o's text format, at full precision.

Information matrices are the upper triangle by rows: ``I11 I12 I13 I22 I23 I33`` (TORO has another order:
a file in that order shows up as an indefinite matrix and is refused). Lines used: ``VERTEX_SE2 id x y
theta``, ``FIX id``, ``EDGE_SE2 i j x y theta I...`` and, for factors on one pose, ``EDGE_PRIOR_SE2 i x y
theta I...``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mfslam.output.reading import read_lines
from mfslam.types import Edge, FloatArray, IntArray, MfslamError

_UPPER = np.triu_indices(3)
_FORMS = {
    "VERTEX_SE2": (1, 3, "id x y theta"),
    "EDGE_SE2": (2, 9, "i j x y theta I11 I12 I13 I22 I23 I33"),
    "EDGE_PRIOR_SE2": (1, 9, "i x y theta I11 I12 I13 I22 I23 I33"),
}


@dataclass(frozen=True, eq=False)
class GraphFile:
    """A pose graph as a file tells it.

    ``ids`` (N,) and ``world_T_pose`` (N, 3) in file order; ``fixed``: ids held where they are. Edges E:
    ``i``, ``j`` (E,) ids, equal for a prior; ``i_T_j`` (E, 3), for a prior the pose itself;
    ``information`` (E, 3, 3), order x, y, theta.
    """

    ids: IntArray
    world_T_pose: FloatArray
    fixed: frozenset[int]
    i: IntArray
    j: IntArray
    i_T_j: FloatArray
    information: FloatArray


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


def _edge_line(edge: Edge, information: FloatArray) -> str:
    head = f"EDGE_PRIOR_SE2 {edge.i}" if edge.i == edge.j else f"EDGE_SE2 {edge.i} {edge.j}"
    return f"{head} {_numbers(edge.i_T_j.tolist())} {_numbers(information[_UPPER].tolist())}"


def _numbers(values: list[float]) -> str:
    return " ".join(f"{value:.17g}" for value in values)


def read_g2o(path: Path) -> GraphFile:
    """Read a 2D g2o file strictly.

    Raises MfslamError with file and line: unknown tag, wrong count of fields, numbers not finite, an id
    given twice, an edge to an unknown id, an information matrix that is not positive semidefinite.
    """
    ids: dict[int, int] = {}
    poses: list[list[float]] = []
    fixed: dict[int, int] = {}
    ends: list[tuple[int, int]] = []
    values: list[list[float]] = []
    lines: list[int] = []
    for number, line in read_lines(path):
        fields = line.partition("#")[0].split()
        if not fields:
            continue
        where = f"{path}:{number}"
        if fields[0] == "FIX":
            fixed |= {_integer(text, where): number for text in fields[1:]}
            continue
        keys, numbers = _parse(fields, where)
        if fields[0] == "VERTEX_SE2":
            if keys[0] in ids:
                raise MfslamError(f"{where}: vertex {keys[0]} was already given on line {ids[keys[0]]}")
            ids[keys[0]] = number
            poses.append(numbers)
        else:
            ends.append((keys[0], keys[-1]))
            values.append(numbers)
            lines.append(number)
    if not ids:
        raise MfslamError(f"{path}: holds no pose; expected lines of 'VERTEX_SE2 id x y theta'")
    _check_known(path, ids, [*zip(lines, ends, strict=True), *((n, (k, k)) for k, n in fixed.items())])
    table = np.array(values, dtype=np.float64).reshape(-1, 9)
    pairs = np.array(ends, dtype=np.int64).reshape(-1, 2)
    information = _symmetric(table[:, 3:])
    _check_information(path, information, lines)
    return GraphFile(
        np.fromiter(ids, dtype=np.int64, count=len(ids)),
        np.array(poses, dtype=np.float64),
        frozenset(fixed),
        pairs[:, 0],
        pairs[:, 1],
        table[:, :3],
        information,
    )


def _parse(fields: list[str], where: str) -> tuple[list[int], list[float]]:
    tag = fields[0]
    if tag not in _FORMS:
        raise MfslamError(f"{where}: {tag}: expected one of FIX, {', '.join(_FORMS)} (a 2D g2o file)")
    n_keys, n_values, form = _FORMS[tag]
    if len(fields) != 1 + n_keys + n_values:
        raise MfslamError(f"{where}: expected '{tag} {form}', got {len(fields) - 1} fields after {tag}")
    keys = [_integer(text, where) for text in fields[1 : 1 + n_keys]]
    try:
        numbers = [float(text) for text in fields[1 + n_keys :]]
    except ValueError:
        raise MfslamError(f"{where}: expected '{tag} {form}', got a field that is no number") from None
    if not all(map(math.isfinite, numbers)):
        raise MfslamError(f"{where}: expected finite numbers after {tag}")
    return keys, numbers


def _integer(text: str, where: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise MfslamError(f"{where}: expected a whole number as id, got {text!r}") from None


def _check_known(path: Path, ids: dict[int, int], mentions: list[tuple[int, tuple[int, int]]]) -> None:
    for number, keys in mentions:
        for key in keys:
            if key not in ids:
                raise MfslamError(f"{path}:{number}: vertex {key} is nowhere in the file")


def _symmetric(upper: FloatArray) -> FloatArray:
    out = np.zeros((len(upper), 3, 3))
    out[:, _UPPER[0], _UPPER[1]] = upper
    out[:, _UPPER[1], _UPPER[0]] = upper
    return out


def _check_information(path: Path, information: FloatArray, lines: list[int]) -> None:
    eigenvalues = np.linalg.eigvalsh(information)
    bad = np.flatnonzero(eigenvalues[:, 0] < -1e-9 * np.maximum(eigenvalues[:, 2], 1.0))
    if len(bad):
        raise MfslamError(
            f"{path}:{lines[bad[0]]}: the information matrix has a negative eigenvalue "
            f"({eigenvalues[bad[0], 0]:.4g}; {len(bad)} edges so): expected I11 I12 I13 I22 I23 I33, "
            "perhaps this file is in TORO's order I11 I12 I22 I33 I13 I23"
        )
