"""Pose graphs in g2o's and TORO's text formats, read strictly.

Poses: ``VERTEX_SE2`` or ``VERTEX2 id x y theta``; ``FIX id ...``. Edges: ``EDGE_SE2`` or ``EDGE2 i j x y theta``
and, for factors on one pose, ``EDGE_PRIOR_SE2 i x y theta``, each with six numbers of the information matrix:
``I11 I12 I13 I22 I23 I33`` in g2o's order, ``I11 I12 I22 I33 I13 I23`` in TORO's. The tag tells which,
unless the matrices then have negative eigenvalues and those of the other order have none.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Literal

import numpy as np

from mfslam.output.reading import read_lines
from mfslam.pose_graphs.data import GraphFile
from mfslam.se2 import LARGEST, are_of_a_pose
from mfslam.types import FloatArray, MfslamError

InformationOrder = Literal["g2o", "toro"]

_ORDERS: dict[InformationOrder, tuple[int, ...]] = {  # where I11 I12 I13 I22 I23 I33 stand
    "g2o": (0, 1, 2, 3, 4, 5),
    "toro": (0, 1, 4, 2, 5, 3),
}
_SPELLED: dict[InformationOrder, str] = {
    "g2o": "I11 I12 I13 I22 I23 I33",
    "toro": "I11 I12 I22 I33 I13 I23",
}
_SYMMETRIC = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])
_EDGE = "i j x y theta, then the six numbers of the information matrix"
# tag: ids, numbers, what stands there
_FORMS = {
    "VERTEX_SE2": (1, 3, "id x y theta"),
    "VERTEX2": (1, 3, "id x y theta"),
    "EDGE_SE2": (2, 9, _EDGE),
    "EDGE2": (2, 9, _EDGE),
    "EDGE_PRIOR_SE2": (1, 9, "i x y theta, then the six numbers of the information matrix"),
}
_LEFT_OUT = {
    "EQUIV": "EQUIV lines (two names of one pose) are left out, as other optimisers do",
    "PARAMS_SE2OFFSET": "PARAMS_SE2OFFSET lines are left out: no edge that needs them is read",
}
_MOST = 1e30  # of information: sigmas of a millionth of an atom
_NO_DOUBLE_SIGN = -1e-9  # an eigenvalue below this share of the largest one is negative


def read_graph(path: Path, order: InformationOrder | None = None) -> GraphFile:
    """Read a planar pose graph; ``order`` overrules what the tags say of the information matrices.

    Raises MfslamError with file and line: unknown tag, wrong count of fields, numbers not finite, an id
    given twice, an edge to an unknown id or from a pose to itself, an information matrix that is not
    positive semidefinite in the order asked for or in either.
    """
    ids: dict[int, int] = {}
    poses: list[list[float]] = []
    fixed: dict[int, int] = {}
    edges: list[tuple[str, int, int, int]] = []  # tag, line, i, j
    values: list[list[float]] = []
    left_out: Counter[str] = Counter()
    for number, line in read_lines(path):
        fields = line.partition("#")[0].split()
        if not fields:
            continue
        tag = fields[0]
        if tag in _FORMS:
            keys, numbers = _parse(fields, path, number)
            if len(numbers) == 3:
                if ids.setdefault(keys[0], number) != number:
                    raise MfslamError(
                        f"{path}:{number}: vertex {keys[0]} was already given on line {ids[keys[0]]}"
                    )
                poses.append(numbers)
                continue
            if len(keys) == 2 and keys[0] == keys[1]:
                raise MfslamError(f"{path}:{number}: an edge from vertex {keys[0]} to itself")
            edges.append((tag, number, keys[0], keys[-1]))
            values.append(numbers)
        elif tag == "FIX":
            fixed |= {_integer(text, path, number): number for text in fields[1:]}
        elif tag in _LEFT_OUT:
            left_out[tag] += 1
        else:
            raise MfslamError(f"{path}:{number}: {_why_not(tag)}")
    if not ids:
        raise MfslamError(f"{path}: holds no pose; expected lines of 'VERTEX_SE2 id x y theta'")
    _check_known(
        path, ids, [*((n, k) for _, n, i, j in edges for k in (i, j)), *((n, k) for k, n in fixed.items())]
    )
    table = np.array(values, dtype=np.float64).reshape(-1, 9)
    information, notes = _information(path, table[:, 3:], [e[0] for e in edges], [e[1] for e in edges], order)
    notes += [f"{count} {_LEFT_OUT[tag]}" for tag, count in left_out.items()]
    pairs = np.array([edge[2:] for edge in edges], dtype=np.int64).reshape(-1, 2)
    return GraphFile(
        np.fromiter(ids, dtype=np.int64, count=len(ids)),
        np.array(poses, dtype=np.float64),
        frozenset(fixed),
        pairs[:, 0],
        pairs[:, 1],
        table[:, :3],
        information,
        tuple(notes),
    )


def _parse(fields: list[str], path: Path, number: int) -> tuple[list[int], list[float]]:
    tag = fields[0]
    n_keys, n_values, form = _FORMS[tag]
    if len(fields) != 1 + n_keys + n_values:
        raise MfslamError(
            f"{path}:{number}: expected '{tag} {form}', got {len(fields) - 1} fields after {tag}"
        )
    keys = [_integer(text, path, number) for text in fields[1 : 1 + n_keys]]
    try:
        numbers = [float(text) for text in fields[1 + n_keys :]]
        if not are_of_a_pose(numbers[:3]) or not all(abs(value) <= _MOST for value in numbers[3:]):
            raise MfslamError(
                f"{path}:{number}: expected finite numbers after {tag}, poses up to {LARGEST:g}, information up to {_MOST:g}"
            )
        if any("_" in text for text in fields[1:]):  # Python's own spelling of numbers
            raise ValueError
    except ValueError:
        raise MfslamError(
            f"{path}:{number}: expected '{tag} {form}', got a field that is no number"
        ) from None
    return keys, numbers


def _integer(text: str, path: Path, number: int) -> int:
    try:
        value = int(text)
    except ValueError:
        raise MfslamError(f"{path}:{number}: expected a whole number as id, got {text[:40]!r}") from None
    if abs(value) >= 2**63:
        raise MfslamError(f"{path}:{number}: expected an id of at most 63 bits, got {text[:40]}")
    return value


def _why_not(tag: str) -> str:
    if "SE3" in tag or tag in ("VERTEX3", "EDGE3"):
        return f"{tag}: this is a graph in three dimensions; only planar ones are read (VERTEX_SE2, EDGE_SE2)"
    if "XY" in tag:
        return f"{tag}: landmarks are not read, only poses and the edges between them"
    return f"{tag[:40]}: expected one of FIX, {', '.join(_FORMS)} (a planar graph in g2o's or TORO's format)"


def _check_known(path: Path, ids: dict[int, int], mentions: list[tuple[int, int]]) -> None:
    for number, key in mentions:
        if key not in ids:
            raise MfslamError(f"{path}:{number}: vertex {key} is nowhere in the file")


def _information(
    path: Path, six: FloatArray, tags: list[str], lines: list[int], asked: InformationOrder | None
) -> tuple[FloatArray, list[str]]:
    """Information matrices (E, 3, 3) of six numbers (E, 6) each, and what to tell of their order."""
    toro = np.array([tag == "EDGE2" for tag in tags], dtype=np.bool_)
    if asked is not None:
        out = _matrices(six, asked)
        _refuse_negative(path, out, lines, f"in the order {_SPELLED[asked]} that was asked for")
        return out, []
    out = np.where(toro[:, None, None], _matrices(six, "toro"), _matrices(six, "g2o"))
    if not _negative(out).any():
        return out, []
    turned = np.where(toro[:, None, None], _matrices(six, "g2o"), _matrices(six, "toro"))
    if _negative(turned).any():
        _refuse_negative(path, out, lines, "in its tag's order and no common order of I11 ... I33 mends it")
    found: InformationOrder = "g2o" if toro.any() else "toro"
    if toro.any() and not toro.all():
        raise MfslamError(
            f"{path}: the order of the information matrices is unclear; say --information-order g2o or toro"
        )
    return turned, [f"information matrices are in the order {_SPELLED[found]}, unlike what their tags say"]


def _matrices(six: FloatArray, order: InformationOrder) -> FloatArray:
    return np.asarray(six[:, _ORDERS[order]][:, _SYMMETRIC])


def _negative(information: FloatArray) -> FloatArray:
    """(E,): the least eigenvalue where it is below zero by more than rounding, else 0."""
    if not len(information):
        return np.zeros(0)
    eigenvalues = np.linalg.eigvalsh(information)
    limit = _NO_DOUBLE_SIGN * np.maximum(eigenvalues[:, 2], 1.0)
    return np.where(eigenvalues[:, 0] < limit, eigenvalues[:, 0], 0.0)


def _refuse_negative(path: Path, information: FloatArray, lines: list[int], where: str) -> None:
    negative = _negative(information)
    bad = np.flatnonzero(negative)
    if len(bad):
        raise MfslamError(
            f"{path}:{lines[bad[0]]}: the information matrix has a negative eigenvalue ({negative[bad[0]]:.4g}; "
            f"{len(bad)} of {len(lines)} edges so) {where}"
        )
