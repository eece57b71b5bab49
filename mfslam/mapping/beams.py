"""Beams of successive scans, placed in the world."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from mfslam.config import Config
from mfslam.deskew import beam_step_rad, beam_times_s
from mfslam.kernels import raytrace
from mfslam.types import Float32Array, FloatArray, IntArray, Laser, Scan

_CHUNK_BEAMS = 100_000

Given = TypeVar("Given")
Made = TypeVar("Made")


@dataclass(frozen=True, eq=False)
class Beams:
    """``starts_m``, ``ends_m`` (C, N, 2) of beams in the world, ``kinds`` and ``stamps_ns`` (C, N).

    ``sigma_m``: how far an end may lie off its wall, one sigma. ``step_rad``: angle from beam to beam.
    """

    stamps_ns: IntArray
    starts_m: FloatArray
    ends_m: FloatArray
    kinds: raytrace.KindArray
    sigma_m: float
    step_rad: float

    def stood_m(self) -> FloatArray:
        """Where the laser stood (K, 2): one point of each scan that says anything."""
        heard = self.kinds != raytrace.SILENT
        scan = np.flatnonzero(heard.any(axis=1))
        points: FloatArray = self.starts_m[scan, heard[scan].argmax(axis=1)]
        return points


@dataclass(frozen=True, eq=False)
class ScanGroup:
    """A few successive scans of one laser: ``ranges_m`` (C, N), ``world_T_body`` (C, 3) at their reference instants,
    ``twists`` (C, 6) there and their change per second (zero where scans are taken as snapshots), ``times_s`` (N,) of the beams
    from the reference."""

    stamps_ns: IntArray
    laser: Laser
    ranges_m: Float32Array
    world_T_body: FloatArray
    twists: FloatArray
    times_s: FloatArray
    config: Config

    def place(self) -> Beams:
        """All beams as they were sensed."""
        laser, no_return_m = self.laser, self.config.map.no_return_free_m
        starts = np.empty((*self.ranges_m.shape, 2))
        ends, kinds = np.empty_like(starts), np.empty(self.ranges_m.shape, np.int8)
        raytrace.place_beams(
            self.ranges_m, self.world_T_body, self.twists, laser.angles_rad, self.times_s, laser.body_T_laser,
            (laser.range_min_m, laser.range_max_m, no_return_m), starts, ends, kinds,
        )  # fmt: skip
        offsets_ns = np.round(laser.offsets_s * 1e9).astype(np.int64)
        # noise of the range, and what is left of the poses' errors
        sigma_m = math.hypot(laser.range_sigma_m, self.config.map.pose_sigma_m)
        stamps_ns = self.stamps_ns[:, None] + offsets_ns
        return Beams(stamps_ns, starts, ends, kinds, sigma_m, beam_step_rad(laser))

    def place_for_map(self, bounds_m: FloatArray) -> Beams:
        """The same, without hits that lie between two surfaces, and cut at ``map.max_range_m``. Widens ``bounds_m`` (4,), x_min,
        y_min, x_max, y_max, to hold them."""
        beams = self.place()
        raytrace.drop_mixed(
            self.ranges_m, beams.starts_m, beams.ends_m, beams.kinds, self.laser.range_sigma_m, beams.step_rad
        )
        raytrace.limit_range(beams.starts_m, beams.ends_m, beams.kinds, self.config.map.max_range_m, bounds_m)
        return beams


def ahead(given: Iterable[Given], make: Callable[[Given], Made], threads: int = 1) -> Iterator[Made]:
    """What ``make`` makes of each, in order. Threads work on the next ones while the caller uses the last: kernels let them."""
    coming: deque[Future[Made]] = deque()
    with ThreadPoolExecutor(threads) as pool:
        for each in given:
            coming.append(pool.submit(make, each))
            if len(coming) > threads:
                yield coming.popleft().result()
        while coming:
            yield coming.popleft().result()


def scan_groups(
    scans: Sequence[Scan], world_T_body: FloatArray, twists: FloatArray, config: Config
) -> Iterator[ScanGroup]:
    """All scans in log order, as many at once as are quick and small."""
    first = 0
    while first < len(scans):
        laser = scans[first].laser
        end = first + 1
        most = max(1, _CHUNK_BEAMS // max(1, laser.angles_rad.size))
        while end < min(len(scans), first + most) and scans[end].laser is laser:
            end += 1
        yield _group(scans[first:end], world_T_body[first:end], twists[first:end], config)
        first = end


def _group(scans: Sequence[Scan], world_T_body: FloatArray, twists: FloatArray, config: Config) -> ScanGroup:
    laser = scans[0].laser
    ranges_m = np.stack([scan.ranges_m for scan in scans])
    times_s = beam_times_s(laser)
    if config.deskew.mode == "range":
        ranges_m = (ranges_m + twists[:, :1] * times_s).astype(np.float32)  # eqs. 19-24
    told = np.zeros((len(scans), 6))
    if config.deskew.mode == "pose":
        told[:, : twists.shape[1]] = twists
    stamps_ns = np.array([scan.stamp_ns for scan in scans], dtype=np.int64)
    return ScanGroup(stamps_ns, laser, ranges_m, world_T_body, told, times_s, config)
