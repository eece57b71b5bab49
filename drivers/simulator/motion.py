"""The true motion of a simulated robot: a chain of constant twists, exact at any instant."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.simulator.chain import chained, chained_headings, poses_on_twists
from mfslam import se2
from mfslam.types import FloatArray


@dataclass(frozen=True, eq=False)
class Motion:
    """Piecewise constant body twist.

    ``times_s`` (K+1,): knots, increasing. ``twists`` (K, 3): body velocity (m/s, m/s, rad/s) between
    knots. ``world_T_body`` (K+1, 3): pose at the knots. Before the first and after the last knot the
    robot stands still.
    """

    times_s: FloatArray
    twists: FloatArray
    world_T_body: FloatArray

    @staticmethod
    def from_twists(
        durations_s: Sequence[float] | FloatArray,
        twists: Sequence[Sequence[float]] | FloatArray,
        world_T_start: Sequence[float] | FloatArray = (0.0, 0.0, 0.0),
    ) -> Motion:
        """Hold each of ``twists`` (K, 3) for its duration (K,), one after the other."""
        durations = np.asarray(durations_s, dtype=np.float64)
        held = np.asarray(twists, dtype=np.float64).reshape(-1, 3)
        if durations.shape != (held.shape[0],) or not np.all(durations > 0.0):
            raise ValueError(f"expected {held.shape[0]} positive durations, got {durations.shape}")
        steps = se2.exp(held * durations[:, None])
        start = np.asarray(world_T_start, dtype=np.float64)
        headings = chained_headings(float(start[2]), steps[:, 2])
        poses = chained(start, steps, headings, np.cos(headings[:-1]), np.sin(headings[:-1]))
        times = np.concatenate([[0.0], np.cumsum(durations)])
        return Motion(times, held, poses)

    @property
    def duration_s(self) -> float:
        return float(self.times_s[-1])

    @property
    def distance_m(self) -> float:
        """Length of the path driven."""
        speed = np.hypot(self.twists[:, 0], self.twists[:, 1])
        return float(np.sum(speed * np.diff(self.times_s)))

    def at(self, times_s: FloatArray | float) -> FloatArray:
        """world_T_body (..., 3) at any times (...), s from the start."""
        times = np.asarray(times_s, dtype=np.float64)
        flat = poses_on_twists(times.ravel(), self.times_s, self.world_T_body, self.twists)
        return np.asarray(flat, dtype=np.float64).reshape((*times.shape, 3))

    def travel(self, times_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Forward distance (m) and turn (rad, not wrapped) since the start, each (...): what wheels see."""
        steps = np.diff(self.times_s)[:, None] * self.twists
        total = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
        forward = np.interp(times_s, self.times_s, total[:, 0])
        turned = np.interp(times_s, self.times_s, total[:, 2])
        return forward, turned

    def twist_at(self, times_s: FloatArray | float) -> FloatArray:
        """Body twist (..., 3) at times (...)."""
        times = np.asarray(times_s, dtype=np.float64)
        knot = np.searchsorted(self.times_s, times, side="right") - 1
        inside = (knot >= 0) & (knot < self.twists.shape[0])
        twist = self.twists[np.clip(knot, 0, self.twists.shape[0] - 1)]
        return np.asarray(np.where(inside[..., None], twist, 0.0))
