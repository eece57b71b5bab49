"""How good each of several results is against one truth, and which differences between them are real."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import combinations
from typing import Any

import numpy as np

from mfslam import se2
from mfslam.metrics import (
    Difference,
    Drift,
    Nees,
    PoseError,
    Relations,
    RelationsError,
    absolute_errors,
    align,
    associate,
    drift,
    nees,
    paired_bootstrap,
    relation_errors,
    rpe,
)
from mfslam.output.results import GraphTruth, Result
from mfslam.types import BoolArray, FloatArray, IntArray, MfslamError

ALIGNMENTS = ("none", "origin", "best")


@dataclass(frozen=True, eq=False)
class Errors:
    """``m`` and ``deg`` (M,) over the truth's entries that are ``matched`` (T,); ``at`` (M,): where on the x axis."""

    m: FloatArray
    deg: FloatArray
    matched: BoolArray
    at: FloatArray

    @classmethod
    def of(cls, errors: FloatArray, matched: BoolArray, at: FloatArray) -> Errors:
        return cls(np.hypot(errors[:, 0], errors[:, 1]), np.degrees(np.abs(errors[:, 2])), matched, at)


@dataclass(frozen=True, eq=False)
class Score:
    """All that one result got. ``relations`` and ``poses``: single errors, ATE under the best alignment."""

    name: str
    relations: Errors | None = None
    poses: Errors | None = None
    ate: dict[str, PoseError] = field(default_factory=dict)
    rpe: PoseError | None = None
    drift: list[Drift] = field(default_factory=list)
    nees: Nees | None = None
    path: FloatArray | None = None  # (N, 3) all poses in the truth's frame
    true_path: FloatArray | None = None

    @property
    def relations_error(self) -> RelationsError | None:
        if self.relations is None:
            return None
        e, stats = self.relations, PoseError.of(_as_poses(self.relations))
        matched = int(e.matched.sum())
        return RelationsError(stats.translation_m, stats.rotation_deg, matched, len(e.matched) - matched)

    def as_json(self) -> dict[str, Any]:
        out: dict[str, Any] = {"name": self.name}
        if self.relations_error is not None:
            out["relations"] = self.relations_error.as_json()
        if self.poses is not None:
            out["matched"] = int(self.poses.matched.sum())
            out["unmatched"] = int((~self.poses.matched).sum())
            out["ate"] = {name: error.as_json() for name, error in self.ate.items()}
            out["rpe"] = None if self.rpe is None else self.rpe.as_json()
            out["drift"] = [row.as_json() for row in self.drift]
        if self.nees is not None:
            out["nees"] = self.nees.as_json()
        return out


def _as_poses(errors: Errors) -> FloatArray:
    return np.column_stack([errors.m, np.zeros_like(errors.m), np.radians(errors.deg)])


def against_relations(result: Result, relations: Relations, tolerance_s: float) -> Score:
    """Raises MfslamError when nothing matches, with both time ranges."""
    errors, matched = relation_errors(_stamps(result), result.world_T_body, relations, tolerance_s)
    at = (relations.a_ns[matched] - relations.a_ns.min()) * 1e-9
    return Score(result.name, Errors.of(errors, matched, at), path=result.world_T_body)


def against_truth(result: Result, truth: Result, max_difference_s: float, step: int) -> Score:
    """Against a true trajectory. Raises MfslamError when nothing matches, with both time ranges."""
    if truth.stamps_ns is None:
        raise MfslamError(f"{truth.name}: a graph has no stamps; give it as --graph-truth")
    stamps_ns = _stamps(result)
    order = np.argsort(truth.stamps_ns, kind="stable")  # a log's stamps may go backwards
    t, r = associate(truth.stamps_ns[order], stamps_ns, max_difference_s)
    matched = np.zeros(len(order), dtype=np.bool_)
    matched[t] = True
    seconds = (truth.stamps_ns[order][t] - truth.stamps_ns.min()) * 1e-9
    covariances = None if result.covariances is None else result.covariances[r]
    return _against_poses(
        result, truth.world_T_body[order][t], result.world_T_body[r], matched, seconds, step, covariances
    )


def against_graph_truth(result: Result, truth: GraphTruth, step: int) -> Score:
    """Against true poses or edges of a graph. Raises MfslamError when no id is in both."""
    if result.ids is None:
        raise MfslamError(f"{result.name}: expected a graph (g2o) to hold against --graph-truth")
    if truth.pairs is not None and truth.a_T_b is not None:
        rows, found = _rows(result.ids, truth.pairs)
        both: BoolArray = np.asarray(found.all(axis=1))
        _refuse_none(result, both, truth.pairs)
        i, j = rows[both].T
        estimate = se2.between(result.world_T_body[i], result.world_T_body[j])
        errors = se2.between(truth.a_T_b[both], estimate)
        return Score(
            result.name, Errors.of(errors, both, truth.pairs[both, 0].astype(float)), path=result.world_T_body
        )
    assert truth.ids is not None and truth.world_T_pose is not None
    rows, found = _rows(result.ids, truth.ids)
    _refuse_none(result, found, truth.ids)
    at = truth.ids[found].astype(np.float64)
    return _against_poses(
        result, truth.world_T_pose[found], result.world_T_body[rows[found]], found, at, step, None
    )


def _rows(ids: IntArray, wanted: IntArray) -> tuple[IntArray, BoolArray]:
    order = np.argsort(ids)
    at = np.minimum(np.searchsorted(ids[order], wanted), len(ids) - 1)
    return order[at], ids[order][at] == wanted


def _refuse_none(result: Result, found: BoolArray, ids: IntArray) -> None:
    if not found.any():
        assert result.ids is not None
        raise MfslamError(
            f"{result.name}: no vertex of the truth is in it: the truth has {ids.min()} to {ids.max()}, "
            f"the graph {result.ids.min()} to {result.ids.max()}"
        )


def _against_poses(
    result: Result,
    truth: FloatArray,
    estimate: FloatArray,
    matched: BoolArray,
    at: FloatArray,
    step: int,
    covariances: FloatArray | None,
) -> Score:
    if len(truth) < 2:
        raise MfslamError(f"{result.name}: only one pose is matched with the truth; at least two are needed")
    errors = {name: absolute_errors(truth, estimate, name) for name in ALIGNMENTS}  # type: ignore[arg-type]
    return Score(
        result.name,
        poses=Errors.of(errors["best"], matched, at),
        ate={name: PoseError.of(error) for name, error in errors.items()},
        rpe=rpe(truth, estimate, step) if len(truth) > step else None,
        drift=drift(truth, estimate),
        nees=None if covariances is None else nees(truth, estimate, covariances),
        path=se2.compose(align(truth, estimate), result.world_T_body),
        true_path=truth,
    )


def _stamps(result: Result) -> IntArray:
    if result.stamps_ns is None:
        raise MfslamError(f"{result.name}: a graph has no stamps; hold it against --graph-truth")
    return result.stamps_ns


def differences(scores: list[Score]) -> list[dict[str, Any]]:
    """Every two results over what both have matched: relations or poses, in m and in deg."""
    out: list[dict[str, Any]] = []
    for a, b in combinations(scores, 2):
        for metric, of_a, of_b in (("relations", a.relations, b.relations), ("ATE", a.poses, b.poses)):
            if of_a is None or of_b is None:
                continue
            both = of_a.matched & of_b.matched
            if not both.any():
                continue
            pick_a, pick_b = both[of_a.matched], both[of_b.matched]
            for unit in ("m", "deg"):
                found: Difference = paired_bootstrap(getattr(of_a, unit)[pick_a], getattr(of_b, unit)[pick_b])
                out.append({"a": a.name, "b": b.name, "metric": metric, "unit": unit} | found.as_json())
    return out
