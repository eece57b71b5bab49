"""How wrong a laser's ranges are at which range: walls seen from near and from far tell.

A laser that compares phases (URG-04LX) is wrong by a wave along the range; 3 to 4 cm were found. Poses and walls are unknowns of
the same problem: what a wrong range does to a map looks like bent ways as well (`range_problem`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mfslam.adjustment import Noise, ScanPoints
from mfslam.calibration.range_problem import ALIKE_M, RangeProblem, RangeState, scan_points
from mfslam.config import SensorConfig
from mfslam.deskew import deskew
from mfslam.ranges import range_errors_m
from mfslam.slam import Slam, Solution
from mfslam.types import BoolArray, FloatArray, IntArray

STEP_M, FARTHEST_M = 0.25, 8.0  # of the knots; farther off too little is square to a beam
LEAST_KEYFRAMES, MOST_KEYFRAMES = 40, 400
ROUNDS, ROUNDS_OF_HALVES, SETTLED_M = 6, 3, 0.001
SURE_M = 0.01  # sigma of an error that counts
SIGNIFICANT_SIGMAS, MATTERS_M = 4.0, 0.01


@dataclass(frozen=True, eq=False)
class RangeErrors:
    """By how much ranges are told too large at knots ``step_m`` apart, from 0: as assumed (``before_m``), as found, one
    sigma; (N,) each."""

    step_m: float
    before_m: FloatArray
    values_m: FloatArray
    sigmas_m: FloatArray

    @property
    def sure(self) -> BoolArray:
        """(N,) of knots: ranges at which enough was seen."""
        return self.sigmas_m < SURE_M

    @property
    def significant(self) -> bool:
        """Whether they are surely others than assumed, by so much that it matters, at two neighbouring knots at least: what is
        wrong at one alone is no error of the range, but something that stood or walked there."""
        change = self.values_m - self.before_m
        differs = self.sure & (np.abs(change) > np.maximum(MATTERS_M, SIGNIFICANT_SIGMAS * self.sigmas_m))
        return bool(np.any(differs[1:] & differs[:-1] & (change[1:] * change[:-1] > 0.0)))

    @property
    def words(self) -> str:
        sure = np.flatnonzero(self.sure)
        low, high = self.values_m[sure].min(), self.values_m[sure].max()
        return f"{low:.3f} to {high:.3f} m between {sure[0] * self.step_m:g} and {sure[-1] * self.step_m:g} m"

    def since(self, sensor: SensorConfig) -> RangeErrors:
        """The same, seen from what the settings of the first pass assume."""
        return replace(self, before_m=range_errors_m(sensor, self.step_m * np.arange(len(self.values_m))))

    def line(self) -> str:
        return f"{'range errors':14s} {self.words} +- {np.median(self.sigmas_m[self.sure]):.4f} m"

    def as_json(self) -> dict[str, Any]:
        return {
            "step_m": self.step_m,
            "assumed_m": self.before_m.tolist(),
            "found_m": self.values_m.tolist(),
            "sigma_m": self.sigmas_m.tolist(),
            "significant": self.significant,
        }


def find_range_errors(slam: Slam, solution: Solution) -> RangeErrors | None:
    """None where the log tells too little of them."""
    keyframes = solution.keyframes[:MOST_KEYFRAMES]
    if len(keyframes) < LEAST_KEYFRAMES:
        return None
    noise = Noise(slam.scans[0].laser.range_sigma_m, slam.config.icp.sigma_floor_m)
    whole = _problem(slam, solution, keyframes)
    if whole is None:
        return None
    state = _solved(whole, whole.start(solution.world_T_reference[keyframes], noise), ROUNDS)
    variances = np.diag(state.covariance) + _scatter_of_halves(
        slam, solution, keyframes, state, whole.knots_m
    )
    sigmas_m = np.sqrt(variances)
    if not np.any(sigmas_m < SURE_M):
        return None
    before_m = range_errors_m(slam.config.sensor, whole.knots_m)
    return RangeErrors(float(whole.knots_m[1]), before_m, before_m + state.errors_m, sigmas_m)


def _problem(
    slam: Slam, solution: Solution, keyframes: IntArray, knots_m: FloatArray | None = None
) -> RangeProblem | None:
    config, scans = slam.config, [slam.scans[n] for n in keyframes.tolist()]
    points = ScanPoints.of(
        (
            deskew(scan, twist, config.deskew, config.icp.point_spacing_m)
            for scan, twist in zip(scans, solution.twists[keyframes], strict=True)
        ),
        sum(scan.ranges_m.size for scan in scans),
        np.array([scan.laser.body_T_laser[:2] for scan in scans]),
        (scan.laser.range_max_m - scan.ranges_m for scan in scans),
    )
    if not len(points.points_m):
        return None
    ranges_m = scan_points(points, [scan.ranges_m for scan in scans])
    last = math.ceil(min(float(ranges_m.max()), FARTHEST_M) / STEP_M)
    within = STEP_M * np.arange(last + 1, dtype=np.float64)
    knots = within if knots_m is None else knots_m
    return RangeProblem(points, ranges_m, knots) if len(knots) > 3 else None


def _solved(problem: RangeProblem, state: RangeState, rounds: int) -> RangeState:
    for _ in range(rounds):
        before, state = state, problem.improved(state)
        change_m = np.abs(state.errors_m - before.errors_m)[np.diag(state.covariance) < SURE_M**2]
        if change_m.max(initial=0.0) < SETTLED_M:
            break
    return state


def _scatter_of_halves(
    slam: Slam, solution: Solution, keyframes: IntArray, state: RangeState, knots_m: FloatArray
) -> FloatArray:
    """(N,) variances of the mean of both halves of the log, by how much farther they are from each other than theirs say: what
    beams have in common, no sum over them shows. As around each knot."""
    middle = len(keyframes) // 2
    found = []
    for half in (slice(0, middle), slice(middle, None)):
        problem = _problem(slam, solution, keyframes[half], knots_m)
        if problem is None:
            return np.full(len(knots_m), np.inf)
        start = RangeState(state.world_T_body[half], state.errors_m, state.covariance, state.noise)
        found.append(_solved(problem, start, ROUNDS_OF_HALVES))
    one, other = found
    variances = np.diag(one.covariance) + np.diag(other.covariance)
    apart = one.errors_m - other.errors_m  # of each another straight line is left out
    apart -= np.polyval(np.polyfit(knots_m, apart, 1, w=variances**-0.5), knots_m)
    near = np.exp(-0.5 * ((knots_m[:, None] - knots_m) / ALIKE_M) ** 2)
    return np.asarray(near @ np.maximum(0.0, apart**2 - variances) / near.sum(axis=1)) / 4.0


def merged(found: Sequence[RangeErrors | None]) -> RangeErrors | None:
    """Of several logs of one laser: each counts by its information."""
    told = [each for each in found if each is not None]
    if not told:
        return None
    longest = max(told, key=lambda each: len(each.values_m))
    count = len(longest.values_m)
    weights = np.zeros((len(told), count))
    values = np.zeros((len(told), count))
    for n, each in enumerate(told):
        weights[n, : len(each.values_m)], values[n, : len(each.values_m)] = each.sigmas_m**-2.0, each.values_m
    total = weights.sum(axis=0)
    mean_m = np.sum(weights * values, axis=0) / total
    return RangeErrors(longest.step_m, longest.before_m, mean_m, total**-0.5)
