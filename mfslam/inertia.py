"""Inertia: where a robot goes on to that no wheels tell of, how sure that is, and what a scan then tells of its speed.

A Kalman filter of the pose in the recent map, of the speed and of the acceleration, which wanders within what robots can do
(Singer 1970). Where scans leave a direction open, the robot goes on along it as it did, and ever less surely; where a scan then
tells where it has come to, that is no jump within one step, but a speed that was wrong ever since.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from mfslam import se2
from mfslam.kernels import poses
from mfslam.recovery import COAST_S, LEAST_PERIOD_S, LEAST_S, MAX_ACCELERATION
from mfslam.types import FloatArray

ACCELERATION_SIGMAS = 0.5 * MAX_ACCELERATION  # it is at its highest now and then
ACCELERATES_S = 1.0  # after which nothing is left of an acceleration
LARGEST_SPEED = np.array([3.0, 1.0, 4.0])  # that is likely (m/s, rad/s)
UNEVEN_SIGMAS = np.array([0.01, 0.01, 0.01])  # of a step: stamps lie a little (m, m, rad)
MOST_PERIODS = 100  # after so many nothing is known of the robot, whatever the time


@dataclass(eq=False)
class Inertia:
    """``step`` (3,): the twist over the usual time between scans, ``period_s``; ``change`` (3,): by how much it grows in that time.
    ``covariance`` (9, 9): of the pose in its tangent, relative to the recent map, of the step and of its change."""

    step: FloatArray = field(default_factory=lambda: np.zeros(3))
    change: FloatArray = field(default_factory=lambda: np.zeros(3))
    covariance: FloatArray = field(default_factory=lambda: np.zeros((9, 9)))
    period_s: float = LEAST_PERIOD_S
    _at_mark: FloatArray = field(default_factory=lambda: np.zeros((3, 3)))
    _unseen: FloatArray = field(default_factory=lambda: np.zeros((3, 3)))

    def begin(self) -> None:
        """Nothing is known of the motion but that robots can drive it."""
        self._stand(np.zeros(3), np.zeros(3), LARGEST_SPEED / 3.0 * self.period_s)

    def told(self, step: FloatArray, dt_s: float, sigmas: FloatArray) -> None:
        """Wheels told the step (3,) over a time: as it was, it goes on. ``sigmas`` (3,): of a pose."""
        self._take_period(dt_s)
        periods = 1.0 if dt_s <= LEAST_S else dt_s / self.period_s
        self._stand(poses.log(step) / periods, sigmas, math.sqrt(2.0) * sigmas)

    def go_on(self, dt_s: float) -> FloatArray:
        """The step (3,) that inertia leads to, over a time that lies where it is short. From here on the covariance is that
        of the pose to which it leads."""
        self._take_period(dt_s)
        periods = 1 if dt_s <= LEAST_S else max(1, round(dt_s / self.period_s))
        onward = np.zeros(3)
        for n in range(min(periods, MOST_PERIODS)):
            moves = self.step + 0.5 * self.change if n * self.period_s < COAST_S else np.zeros(3)
            onward = poses.advance(onward, moves, 1.0)
            self._period(moves)
        return onward

    def _period(self, moves: FloatArray) -> None:
        lasts = math.exp(-self.period_s / ACCELERATES_S)
        carry = np.eye(9)
        carry[:3, :3] = se2.adjoint(se2.inverse(poses.advance(np.zeros(3), moves, 1.0)))
        carry[:3, 3:6] = carry[3:6, 6:] = np.eye(3)
        carry[:3, 6:] = 0.5 * np.eye(3)
        carry[6:, 6:] = lasts * np.eye(3)
        self.step = self.step + self.change
        self.change = lasts * self.change
        out = carry @ self.covariance @ carry.T
        out[:3, :3] += np.diag(UNEVEN_SIGMAS**2)
        out[6:, 6:] += np.diag((1.0 - lasts**2) * (ACCELERATION_SIGMAS * self.period_s**2) ** 2)
        # a robot that nobody has seen for long is no faster than robots are
        too_fast = np.sqrt(np.diag(out)[3:6]) / (LARGEST_SPEED * self.period_s)
        shrink = np.concatenate([np.ones(3), 1.0 / np.maximum(1.0, too_fast), np.ones(3)])
        self.covariance = shrink[:, None] * out * shrink

    @property
    def sigmas(self) -> FloatArray:
        """(3,) of the pose, in its tangent."""
        return np.sqrt(np.diag(self.covariance)[:3])

    @property
    def information(self) -> FloatArray:
        """(3, 3) of the pose."""
        return np.asarray(np.linalg.inv(self.covariance[:3, :3]))

    def _if(self, off: FloatArray) -> tuple[FloatArray, FloatArray]:
        gain = np.linalg.solve(self.covariance[:3, :3], self.covariance[:3, 3:]).T
        more = gain @ off
        return self.step + more[:3], self.change + more[3:]

    def twist_if(self, off: FloatArray) -> FloatArray:
        """The twist per second if the pose is ``off`` (3,) from where inertia has led."""
        return self._if(off)[0] / self.period_s

    def found(self, off: FloatArray, information: FloatArray) -> None:
        """The pose is ``off`` (3,), in the tangent where inertia has led, and a scan knows it with ``information`` (3, 3)."""
        self.step, self.change = self._if(off)
        p = self.covariance
        gain = np.linalg.solve(np.eye(3) + information @ p[:3, :3], information @ p[:3, :])
        out = p - p[:, :3] @ gain
        self.covariance = 0.5 * (out + out.T)

    def mark(self) -> None:
        """Remember how sure the pose is here: of a keyframe."""
        self._at_mark, self._unseen = self.covariance[:3, :3].copy(), np.zeros((3, 3))

    def unseen(self, onward: FloatArray) -> FloatArray:
        """(3, 3) covariance of the way ``onward`` (3,) since the mark: by how much less sure the pose is than there, or once was
        on the way, for what a scan then fits may be the next place that looks alike."""
        carry = se2.adjoint(se2.inverse(onward))
        now = self.covariance[:3, :3] - carry @ self._at_mark @ carry.T
        if np.trace(now[:2, :2]) > np.trace(self._unseen[:2, :2]):
            self._unseen = now
        return self._unseen

    def _stand(self, step: FloatArray, sigmas: FloatArray, step_sigmas: FloatArray) -> None:
        self.step, self.change = step, np.zeros(3)
        accelerates = ACCELERATION_SIGMAS * self.period_s**2
        self.covariance = np.diag(np.concatenate([sigmas, step_sigmas, accelerates]) ** 2)

    def _take_period(self, dt_s: float) -> None:
        """The usual time between scans, slowly; the speed stays what it is."""
        if 0.0 < dt_s <= LEAST_S:
            period_s = max(dt_s, LEAST_PERIOD_S)
            is_first = self.period_s == LEAST_PERIOD_S
            self.period_s = period_s if is_first else 0.9 * self.period_s + 0.1 * period_s
