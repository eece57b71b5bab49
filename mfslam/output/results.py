"""Trajectories of any program: a run folder, TUM, CARMEN or g2o, read into one shape."""

from __future__ import annotations

import bz2
import gzip
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np

from mfslam.output.covariance import read_covariances
from mfslam.output.graph_reader import read_graph
from mfslam.output.tum import read_tum, stamp_from_text
from mfslam.se2 import are_of_a_pose
from mfslam.types import FloatArray, IntArray, MfslamError

GRAPH_SUFFIXES = (".g2o", ".graph", ".toro")
CARMEN_SUFFIXES = (".clf", ".log")
_PACKED = (".gz", ".bz2")


@dataclass(frozen=True, eq=False)
class Result:
    """Poses (N, 3) in file order: with ``stamps_ns`` (N,), or from a graph with ``ids`` (N,).

    ``covariances`` (N, 3, 3) of x, y, yaw where a run states them.
    """

    name: str
    world_T_body: FloatArray
    stamps_ns: IntArray | None = None
    ids: IntArray | None = None
    covariances: FloatArray | None = None


def read_result(path: Path) -> Result:
    """Read what ``path`` is. Raises MfslamError with file and line."""
    if path.is_dir():
        return _read_run(path)
    suffixes = [suffix for suffix in path.suffixes if suffix not in _PACKED]
    last = suffixes[-1].lower() if suffixes else ""
    if last in GRAPH_SUFFIXES:
        graph = read_graph(path)
        return Result(path.name, graph.world_T_pose, ids=graph.ids)
    if last in CARMEN_SUFFIXES:
        stamps_ns, poses = read_carmen(path)
        return Result(path.name, poses, stamps_ns)
    stamps_ns, poses = read_tum(path)
    return Result(path.name, poses, stamps_ns)


def _read_run(folder: Path) -> Result:
    path = folder / "trajectory.tum"
    if not path.is_file():
        raise MfslamError(f"{folder}: holds no trajectory.tum, so it is no folder of `mfslam map`")
    stamps_ns, poses = read_tum(path)
    stated = folder / "trajectory.cov"
    covariances = None
    if stated.is_file():
        cov_ns, covariances = read_covariances(stated)
        if not np.array_equal(cov_ns, stamps_ns):
            raise MfslamError(f"{stated}: its stamps are not those of {path.name}; map the log again")
    return Result(folder.name or str(folder), poses, stamps_ns, covariances=covariances)


def read_carmen(path: Path) -> tuple[IntArray, FloatArray]:
    """Stamps (N,) and laser poses (N, 3) of the FLASER or ROBOTLASER1 lines of a corrected CARMEN log.

    Raises MfslamError with file and line.
    """
    stamps: list[int] = []
    poses: list[list[float]] = []
    for number, line in _lines(path):
        fields = line.split()
        if not fields or fields[0] not in ("FLASER", "ROBOTLASER1"):
            continue
        try:
            if fields[0] == "FLASER":
                at = 2 + int(fields[1])
                stamp = fields[at + 6]
            else:
                ranges = int(fields[8])
                at = 10 + ranges + int(fields[9 + ranges])
                stamp = fields[at + 11]
            pose = [float(field) for field in fields[at : at + 3]]
            stamp_ns = stamp_from_text(stamp)
        except (ValueError, IndexError):
            raise MfslamError(
                f"{path}:{number}: expected a whole {fields[0]} line, got {len(fields)} fields"
            ) from None
        if len(pose) != 3 or not are_of_a_pose(pose):
            raise MfslamError(f"{path}:{number}: expected a finite pose of the laser")
        stamps.append(stamp_ns)
        poses.append(pose)
    if not stamps:
        raise MfslamError(f"{path}: holds no FLASER or ROBOTLASER1 line")
    return np.array(stamps, dtype=np.int64), np.array(poses, dtype=np.float64)


def _opened(path: Path) -> IO[str]:
    if path.suffix == ".gz":
        return gzip.open(path, "rt", encoding="utf-8")
    if path.suffix == ".bz2":
        return bz2.open(path, "rt", encoding="utf-8")
    return path.open(encoding="utf-8")


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    try:
        with _opened(path) as file:
            yield from enumerate(file, start=1)
    except (OSError, EOFError, zlib.error) as error:
        why = (getattr(error, "strerror", None) or str(error)).lower()
        raise MfslamError(f"{path}: cannot be read: {why}") from None
    except UnicodeDecodeError:
        raise MfslamError(f"{path}: expected a text file, got binary data") from None


@dataclass(frozen=True, eq=False)
class GraphTruth:
    """True poses (N, 3) of vertices ``ids`` (N,), or true motions ``a_T_b`` (R, 3) between ``pairs`` (R, 2) of them."""

    ids: IntArray | None = None
    world_T_pose: FloatArray | None = None
    pairs: IntArray | None = None
    a_T_b: FloatArray | None = None


def read_graph_truth(path: Path) -> GraphTruth:
    """A g2o file, or a table: ``x y theta`` by vertex from 0, ``id x y theta``, or ``i j x y theta ...`` of
    true edges.

    Raises MfslamError with file and line.
    """
    if path.suffix.lower() in GRAPH_SUFFIXES:
        graph = read_graph(path)
        return GraphTruth(graph.ids, graph.world_T_pose)
    rows: list[list[float]] = []
    for number, line in _lines(path):
        fields = line.partition("#")[0].split()
        if not fields:
            continue
        try:
            row = [float(field) for field in fields]
        except ValueError:
            row = []
        if len(row) < 3 or not are_of_a_pose(row) or (rows and len(row) != len(rows[0])):
            want = (
                f"{len(rows[0])} finite numbers as before"
                if rows
                else "'x y theta', 'id x y theta' or 'i j x y theta ...'"
            )
            raise MfslamError(f"{path}:{number}: expected {want}, got {line.strip()[:80]!r}")
        rows.append(row)
    if not rows:
        raise MfslamError(f"{path}: holds no pose")
    table = np.array(rows)
    if table.shape[1] == 3:
        return GraphTruth(np.arange(len(table)), table)
    if table.shape[1] == 4:
        ids = _ids(path, table[:, 0])
        different, first = np.unique(ids, return_index=True)
        if len(different) < len(ids):
            twice = np.setdiff1d(np.arange(len(ids)), first)[0]
            raise MfslamError(f"{path}: vertex {ids[twice]} is given twice")
        return GraphTruth(ids, table[:, 1:])
    return GraphTruth(
        pairs=np.column_stack([_ids(path, table[:, 0]), _ids(path, table[:, 1])]), a_T_b=table[:, 2:5]
    )


def _ids(path: Path, column: FloatArray) -> IntArray:
    if (column != np.round(column)).any():
        raise MfslamError(
            f"{path}: expected whole numbers as ids, got {column[column != np.round(column)][0]:g}"
        )
    return column.astype(np.int64)
