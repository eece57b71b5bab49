"""What goes wrong on the way into the log, and how it changes what was read."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import AfterValidator, ConfigDict, Field, with_config

from mfslam import se2
from mfslam.types import BoolArray, FloatArray, IntArray

_BURST_STEP_NS = 1_000_000  # scans of one burst are handed over so far apart


def _forward(interval: tuple[float, float]) -> tuple[float, float]:
    if interval[1] <= interval[0]:
        raise ValueError(f"expected [from, to] with from before to, got {list(interval)}")
    return interval


def _in_time(restart: tuple[float, float, float]) -> tuple[float, float, float]:
    if restart[1] < 0.0:
        raise ValueError(
            f"expected [time, silence, clock jump] with a silence of at least 0, got {list(restart)}"
        )
    return restart


Intervals = tuple[Annotated[tuple[float, float], AfterValidator(_forward)], ...]


@with_config(ConfigDict(allow_inf_nan=False))
@dataclass(frozen=True)
class Faults:
    """What goes wrong on the way into the log. Times in s from the start."""

    scan_gaps_s: Annotated[
        Intervals, Field(description="Intervals [from, to] without scans, s from the start: [[10, 12], ...].")
    ] = ()
    drop_share: Annotated[float, Field(ge=0, lt=1, description="Share of scans lost, one by one.")] = 0.0
    odometry_gaps_s: Annotated[
        Intervals, Field(description="Intervals [from, to] without odometry, s from the start.")
    ] = ()
    odometry_jumps: Annotated[
        tuple[tuple[float, float, float, float], ...],
        Field(
            description="[time, x, y, theta], s, m, rad: from then on the odometry frame is displaced, in the body "
            "frame of that instant. For odometry poses only."
        ),
    ] = ()
    stamp_jitter_s: Annotated[
        float, Field(ge=0, description="One-sigma error of each scan's stamp, s. Scans keep their order.")
    ] = 0.0
    burst_scans: Annotated[
        int,
        Field(
            ge=1,
            description="So many scans are handed over together, stamped on arrival: with the stamp of the last, "
            "1 ms apart.",
        ),
    ] = 1
    restarts: Annotated[
        tuple[Annotated[tuple[float, float, float], AfterValidator(_in_time)], ...],
        Field(
            description="[time, silence, clock jump], s: the logger stops, comes back after the silence with counters "
            "and odometry at zero, its clock off by the jump (may be negative)."
        ),
    ] = ()

    @property
    def spoils_stamps(self) -> bool:
        """Whether scans come with other stamps than when they were sensed."""
        return self.stamp_jitter_s > 0.0 or self.burst_scans > 1


def outside(times_s: FloatArray, gaps: Intervals) -> BoolArray:
    """Which of the times (N,) lie in no gap."""
    keep = np.ones(times_s.shape, dtype=bool)
    for start, end in gaps:
        keep &= (times_s < start) | (times_s >= end)
    return keep


def displaced(
    poses: FloatArray, times_s: FloatArray, jumps: tuple[tuple[float, float, float, float], ...]
) -> FloatArray:
    """Odometry poses (N, 3) after jumps of their frame."""
    for at, *jump in sorted(jumps):
        k = int(np.searchsorted(times_s, at))
        if k < len(poses):
            after = se2.compose(poses[k], np.array(jump))
            poses = np.concatenate([poses[:k], se2.compose(after, se2.between(poses[k], poses[k:]))])
    return poses


def spoilt_stamps(stamps_ns: IntArray, faults: Faults, rng: np.random.Generator) -> tuple[IntArray, IntArray]:
    """Stamps (S,) of scans as the log will have them, and when (S,) the logger was given them, if scans took
    no time: not before the last of their burst, never before their stamp."""
    count = len(stamps_ns)
    place = np.arange(count)
    last = np.minimum(place - place % faults.burst_scans + faults.burst_scans - 1, count - 1)
    stamps = stamps_ns[last] + place % faults.burst_scans * _BURST_STEP_NS
    if faults.stamp_jitter_s > 0.0:
        stamps = stamps + np.rint(rng.normal(0.0, faults.stamp_jitter_s * 1e9, count)).astype(np.int64)
    handed_over = np.maximum(stamps_ns[last], stamps)
    return stamps, np.maximum.accumulate(handed_over - place) + place  # one after the other


def awake(from_s: FloatArray, to_s: FloatArray, faults: Faults) -> BoolArray:
    """Which of the readings that take ``from_s`` (N,) to ``to_s`` (N,) no restart cuts."""
    keep = np.ones(from_s.shape, dtype=bool)
    for at, silence, _ in faults.restarts:
        keep &= (to_s < at) | (from_s >= at + silence)
    return keep


def clock_shift_ns(times_s: FloatArray, faults: Faults) -> IntArray:
    """What restarts have added to the log's clock at ``times_s`` (N,)."""
    shift = np.zeros(times_s.shape, dtype=np.int64)
    for at, silence, jump in faults.restarts:
        shift[times_s >= at + silence] += round(jump * 1e9)
    return shift


def counted_anew(counts: FloatArray, times_s: FloatArray, faults: Faults) -> FloatArray:
    """Wheel counters (N, 2) that begin at zero after each restart."""
    counts = counts.copy()
    for at, silence, _ in sorted(faults.restarts):
        k = int(np.searchsorted(times_s, at + silence))
        if k < len(counts):
            counts[k:] -= counts[k].copy()
    return counts


def reckoned_anew(poses: FloatArray, times_s: FloatArray, faults: Faults) -> FloatArray:
    """Odometry poses (N, 3) that begin at the origin after each restart."""
    for at, silence, _ in sorted(faults.restarts):
        k = int(np.searchsorted(times_s, at + silence))
        if k < len(poses):
            poses = np.concatenate([poses[:k], se2.between(poses[k], poses[k:])])
    return poses
