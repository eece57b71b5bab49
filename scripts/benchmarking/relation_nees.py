"""Whether the covariances of maps of real logs are true, as far as hand-verified relations can tell.

The relations' own noise is not known: they were made by hand, from scans. So the surer half of them, by the covariance that
the map states of the way between both poses, tells that noise: the one with which their errors are as large as their median
says. With it, the errors of the other half, over which a map bends more, should be as large as stated.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.special import chdtri

from benchmarking.runs import log_name, mapped_by_default, relations_beside
from mfslam import se2
from mfslam.metrics import read_relations, relation_errors
from mfslam.metrics.matching import nearest
from mfslam.types import FloatArray

HEAD = ["log", "relations", "stated, surer half", "stated, other half", "relations' own noise", "NEES, surer half",
        "NEES, other half", "median, surer half", "median, other half"]  # fmt: skip
SWEPT_M = (0.0, 0.01, 0.02, 0.03)  # noise of relations, as assumed
TURN_PER_M = np.radians(20.0)  # of their turns
BLOCKS = 20  # of relations one after the other, whose errors are alike
LARGEST_NOISE_M, LARGEST_NOISE_RAD = 0.5, 0.5


@dataclass(frozen=True, eq=False)
class Held:
    """Errors (N, 3) of the way between two poses against relations, in the tangent at the second, with the joint
    ``covariances`` (N, 3, 3) that the map states of it."""

    errors: FloatArray
    covariances: FloatArray

    def chi2(self, noise: FloatArray) -> FloatArray:
        """(N,) with relations' own ``noise`` (3,), one sigma."""
        whole = self.covariances + np.diag(noise**2)
        solved = np.linalg.solve(whole, self.errors[:, :, None])[:, :, 0]
        return np.asarray(np.einsum("na,na->n", self.errors, solved))

    def part(self, rows: FloatArray) -> Held:
        return Held(self.errors[rows], self.covariances[rows])


def held_against_relations(path: Path) -> Held:
    """Maps a log by default settings."""
    slam, solution = mapped_by_default(path)
    relations = read_relations(relations_beside(path))
    poses = solution.world_T_body
    errors, matched = relation_errors(solution.stamps_ns, poses, relations)
    a, _ = nearest(solution.stamps_ns, relations.a_ns[matched], 1e-5)
    b, _ = nearest(solution.stamps_ns, relations.b_ns[matched], 1e-5)
    keyframes = solution.keyframes
    i, j = (np.abs(keyframes[None, :] - scans[:, None]).argmin(axis=1) for scans in (a, b))
    assert slam.information is not None
    carry = se2.adjoint(se2.between(poses[b], poses[keyframes[j]]))
    covariances = carry @ slam.information.relative_covariances(i, j) @ np.swapaxes(carry, 1, 2)
    return Held(se2.log(errors), covariances)


def noise_of_relations(held: Held) -> FloatArray:
    """(3,) m, m, rad: with which half of the errors lie within the median of chi2, translation and turn each."""
    plane, turn = held.covariances[:, :2, :2], held.covariances[:, 2, 2]
    e = held.errors

    def of_translation(sigma: float) -> float:
        whole = plane + sigma**2 * np.eye(2)
        return float(
            np.median(np.einsum("na,na->n", e[:, :2], np.linalg.solve(whole, e[:, :2, None])[:, :, 0]))
        )

    def of_turn(sigma: float) -> float:
        return float(np.median(e[:, 2] ** 2 / (turn + sigma**2)))

    sigma_m = _falling_to(of_translation, float(chdtri(2, 0.5)), LARGEST_NOISE_M)
    return np.array([sigma_m, sigma_m, _falling_to(of_turn, float(chdtri(1, 0.5)), LARGEST_NOISE_RAD)])


def _falling_to(chi2: Callable[[float], float], wanted: float, largest: float) -> float:
    low, high = 0.0, largest
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if chi2(middle) > wanted else (low, middle)
    return high


def row_of(name: str, held: Held) -> list[str]:
    stated_m = np.sqrt(np.trace(held.covariances[:, :2, :2], axis1=1, axis2=2))
    surer, other = (
        held.part(rows) for rows in (stated_m <= np.median(stated_m), stated_m > np.median(stated_m))
    )
    noise = noise_of_relations(surer)
    return [
        name, f"{len(stated_m):,}", *(_stated(part) for part in (surer, other)),
        f"{1e3 * noise[0]:.0f} mm {np.degrees(noise[2]):.2f} deg", *(_nees(part, noise) for part in (surer, other)),
        *(f"{np.median(part.chi2(noise)) / chdtri(3, 0.5):.2f}" for part in (surer, other)),
    ]  # fmt: skip


def sweep_row(name: str, held: Held) -> list[str]:
    return [name, *(_nees(held, np.array([m, m, m * TURN_PER_M])) for m in SWEPT_M)]


def _stated(held: Held) -> str:
    """Median of one sigma in the plane, per axis, and of the turn."""
    sigma_m = np.sqrt(0.5 * np.trace(held.covariances[:, :2, :2], axis1=1, axis2=2))
    sigma_deg = np.degrees(np.sqrt(held.covariances[:, 2, 2]))
    return f"{1e3 * np.median(sigma_m):.1f} mm {np.median(sigma_deg):.3f} deg"


def _nees(held: Held, noise: FloatArray) -> str:
    """With its 95 % band, from the spread over blocks."""
    means = np.array([np.mean(block) for block in np.array_split(held.chi2(noise) / 3.0, BLOCKS)])
    band = 1.96 * float(np.std(means, ddof=1)) / np.sqrt(BLOCKS)
    return f"{np.mean(means):.2f} ± {band:.2f}"


def nees_tables(logs: list[Path]) -> list[tuple[str, list[list[str]]]]:
    """NEES with the relations' noise as found, and as assumed."""
    found = [HEAD]
    swept = [["log", *(f"noise {1e3 * m:.0f} mm {np.degrees(m * TURN_PER_M):.1f} deg" for m in SWEPT_M)]]
    for path in logs:
        if relations_beside(path).is_file():
            held = held_against_relations(path)
            found.append(row_of(log_name(path), held))
            swept.append(sweep_row(log_name(path), held))
            print("  ".join(found[-1]), file=sys.stderr, flush=True)
    return [
        ("NEES of the way between the poses of relations, with the relations' own noise as found", found),
        ("The same of all relations, with noise of theirs as assumed", swept),
    ]
