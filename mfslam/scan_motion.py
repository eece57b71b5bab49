"""The motion through every scan, by a smooth trajectory through all of them.

A scan that takes 0.1 s is sensed while the robot speeds up and brakes. What its own poses and those of its neighbours tell of
that is found by smoothing with white noise on the jerk (`kernels.smoothing`), along x, y and the turn of the body: how
much noise is found from the log itself, so that a robot that hardly slips sideways is known not to.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mfslam import se2
from mfslam.kernels import smoothing
from mfslam.types import BoolArray, FloatArray

# of scans that the adjustment placed, and of others (m, m, rad)
ADJUSTED_SIGMAS, MATCHED_SIGMAS = np.array([0.002, 0.002, 0.0007]), np.array([0.004, 0.004, 0.0015])
LEAST_SIGMAS = np.array([0.0005, 0.0005, 0.0001])  # whatever the adjustment says
LEAST_JERK, LARGEST_JERK = 1e-4, 1e4  # (m, m, rad)^2 / s^5
SEARCH_STEPS, SEARCHED_SCANS = (
    10,
    3000,
)  # in search of the jerk; scans in the middle of the log that have a say
SUBSTEPS = 4  # of a motion whose twist changes
UNKNOWN_POSITION = 100.0  # variance of a position that is not measured
SOON_S = 1e-4  # scans so close in time tell nothing of the motion between them


@dataclass(frozen=True, eq=False)
class SmoothMotion:
    """``states`` (S, 3, 3): by scan and axis (x, y, turn of the body) the way since the start, its speed and acceleration at
    ``times_s`` (S,), with ``covariances`` (S, 3, 3, 3). ``jerk`` (3,): spectral density that was found; ``off`` (S, 3): from the
    poses that were smoothed, in their tangents, to the smooth trajectory. ``begins`` (S,): not known how from the scan before; ``variances`` (S, 3)
    of the poses that were smoothed."""

    times_s: FloatArray
    states: FloatArray
    covariances: FloatArray
    jerk: FloatArray
    off: FloatArray
    begins: BoolArray
    variances: FloatArray

    @property
    def twists(self) -> FloatArray:
        """(S, 6) body twist at every scan's instant and its change per second."""
        return np.concatenate([self.states[:, :, 1], self.states[:, :, 2]], axis=1)

    def relative(self, offsets_s: FloatArray) -> FloatArray:
        """(S, 3) pose of the body ``offsets_s`` (S,) later than each scan's instant, seen from the pose at that instant."""
        pose, before = np.zeros((len(offsets_s), 3)), self.states[:, :, 0]
        torn = (self.begins & (offsets_s < 0.0))[:, None]  # before it nothing is known but its own motion
        for n in range(1, SUBSTEPS + 1):
            t = offsets_s[:, None] * (n / SUBSTEPS)
            alone = self.states[:, :, 0] + t * self.states[:, :, 1] + 0.5 * t * t * self.states[:, :, 2]
            way = np.where(torn, alone, self._way(self.times_s + t[:, 0]))
            pose = se2.compose(pose, se2.exp(way - before))
            before = way
        return pose

    def variances_at(self, offsets_s: FloatArray) -> FloatArray:
        """(S, 3) of the smooth trajectory ``offsets_s`` (S,) after each scan's instant, in the tangents there: those of the poses
        that were smoothed, and of a motion of which nothing was measured at that instant."""
        if not offsets_s.any():
            return np.asarray(self.covariances[:, :, 0, 0])
        count = len(self.times_s)
        at_s = np.concatenate([self.times_s, self.times_s + offsets_s])
        order = np.argsort(at_s, kind="stable")
        before = self.begins & (offsets_s < 0.0)
        begins = np.concatenate([self.begins & ~before, before])[order]
        nothing, out = np.full((count, 3), UNKNOWN_POSITION), np.empty((2 * count, 3))
        for axis in range(3):
            variance = np.ascontiguousarray(np.concatenate([self.variances, nothing])[order, axis])
            _, covariances = _smoothed(at_s[order], np.zeros(2 * count), variance, begins, self.jerk[axis])
            out[order, axis] = covariances[:, 0, 0]
        return out[count:]

    def _way(self, at_s: FloatArray) -> FloatArray:
        """(N, 3) way since the start along each axis at instants (N,): of fifth order between scans, of second beyond."""
        times = self.times_s
        a = np.clip(np.searchsorted(times, at_s, side="right") - 1, 0, len(times) - 1)
        b = np.minimum(a + 1, len(times) - 1)
        alone = (times[b] - times[a] < SOON_S) | self.begins[b] | (at_s < times[0])
        start, end = self.states[a], self.states[b]
        t = (at_s - times[a])[:, None]
        h = np.where(alone, 1.0, times[b] - times[a])[:, None]
        s = t / h
        v0, v1 = h * start[..., 1], h * end[..., 1]
        a0, a1 = h * h * start[..., 2], h * h * end[..., 2]
        ahead = v0 * s + 0.5 * a0 * s**2
        d = end[..., 0] - start[..., 0]
        third = 10.0 * d - 6.0 * v0 - 4.0 * v1 - 1.5 * a0 + 0.5 * a1
        fourth = -15.0 * d + 8.0 * v0 + 7.0 * v1 + 1.5 * a0 - a1
        fifth = 6.0 * d - 3.0 * v0 - 3.0 * v1 - 0.5 * a0 + 0.5 * a1
        bend = s**3 * (third + s * (fourth + s * fifth))
        return np.asarray(start[..., 0] + ahead + np.where(alone[:, None], 0.0, bend))


def smooth(
    times_s: FloatArray, world_T_body: FloatArray, variances: FloatArray, begins: BoolArray
) -> SmoothMotion:
    """Smooth poses (S, 3) that have ``variances`` (S, 3) in their tangents at ``times_s`` (S,), which must not decrease."""
    moved = se2.between(world_T_body[:-1], world_T_body[1:])
    steps = se2.log(moved)
    jerk = np.array([_likely_jerk(times_s, steps[:, axis], variances[:, axis], begins) for axis in range(3)])
    motion = _motion(times_s, steps, variances, begins, jerk)
    # a twist that changes leads elsewhere than its mean does: the way is what leads there
    led = motion.relative(np.append(np.diff(times_s), 0.0))[:-1]
    meant = se2.compose(se2.compose(se2.exp(-motion.off[:-1]), moved), se2.exp(motion.off[1:]))
    missed = se2.log(se2.between(led, meant))
    missed[begins[1:] | (np.diff(times_s) < SOON_S)] = 0.0
    return _motion(times_s, steps + missed, variances, begins, jerk)


def _motion(
    times_s: FloatArray, steps: FloatArray, variances: FloatArray, begins: BoolArray, jerk: FloatArray
) -> SmoothMotion:
    way = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    axes = [
        _smoothed(
            times_s,
            np.ascontiguousarray(way[:, axis]),
            np.ascontiguousarray(variances[:, axis]),
            begins,
            float(jerk[axis]),
        )
        for axis in range(3)
    ]
    states = np.stack([state for state, _ in axes], axis=1)
    covariances = np.stack([covariance for _, covariance in axes], axis=1)
    return SmoothMotion(times_s, states, covariances, jerk, states[:, :, 0] - way, begins, variances)


def _smoothed(
    times_s: FloatArray, way: FloatArray, variances: FloatArray, begins: BoolArray, jerk: float
) -> tuple[FloatArray, FloatArray]:
    """States (S, 3) and covariances (S, 3, 3) along one axis."""
    states, covariances = np.empty((len(way), 3)), np.empty((len(way), 3, 3))
    smoothing.run_forward(times_s, way, variances, begins, jerk, states, covariances)
    smoothing.run_back(times_s, begins, jerk, states, covariances)
    return states, covariances


def _likely_jerk(times_s: FloatArray, steps: FloatArray, variances: FloatArray, begins: BoolArray) -> float:
    """The jerk that makes the steps (S - 1,) most likely (golden section of its logarithm)."""
    some = slice(max(0, (len(times_s) - SEARCHED_SCANS) // 2), (len(times_s) + SEARCHED_SCANS) // 2)
    way = np.concatenate([[0.0], np.cumsum(steps)])[some]
    times, variance, torn = times_s[some], np.ascontiguousarray(variances[some]), begins[some]
    states, covariances = np.empty((len(way), 3)), np.empty((len(way), 3, 3))

    def cost(log_jerk: float) -> float:
        jerk = math.exp(log_jerk)
        return float(smoothing.run_forward(times, way, variance, torn, jerk, states, covariances))

    return math.exp(_least(cost, math.log(LEAST_JERK), math.log(LARGEST_JERK)))


def _least(cost: Callable[[float], float], low: float, high: float) -> float:
    """Where a function of one number is least, by golden section."""
    golden = 0.5 * (math.sqrt(5.0) - 1.0)
    left, right = high - golden * (high - low), low + golden * (high - low)
    at_left, at_right = cost(left), cost(right)
    for _ in range(SEARCH_STEPS):
        if at_left < at_right:
            high, right, at_right = right, left, at_left
            left = high - golden * (high - low)
            at_left = cost(left)
        else:
            low, left, at_left = left, right, at_right
            right = low + golden * (high - low)
            at_right = cost(right)
    return 0.5 * (low + high)
