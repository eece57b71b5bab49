"""What the laser sees: the truth at every beam, and what the sensor makes of it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from drivers.simulator.motion import Motion
from drivers.simulator.raycast import cast_and_name
from drivers.simulator.sensors import LaserModel
from drivers.simulator.world import World
from mfslam import se2
from mfslam.types import Float32Array, FloatArray, IntArray

HIT_KINDS = ("nothing", "wall", "glass", "pillar", "door", "person")
_CHUNK_BEAMS = 200_000  # beams cast at once: bounds the memory
_EDGE_M = 0.2  # things that neighbouring beams hit, farther apart than this, have an edge between them


@dataclass(frozen=True, eq=False)
class BeamTruth:
    """The exact truth of S scans of B beams, in double precision.

    ``world_T_laser`` (S, B, 3): the laser's pose at each beam's own instant. ``ranges_m`` (S, B): inf where
    nothing is in range. ``hits`` (S, B): what was hit, as its place in HIT_KINDS.
    """

    world_T_laser: FloatArray
    ranges_m: FloatArray
    hits: npt.NDArray[np.uint8]


def beam_truth(world: World, motion: Motion, laser: LaserModel, instants_s: FloatArray) -> BeamTruth:
    """The truth of the scans sensed at ``instants_s`` (S,): no noise, no rounding. 33 bytes per beam."""
    shape = (len(instants_s), laser.laser.angles_rad.shape[0])
    truth = BeamTruth(np.empty((*shape, 3)), np.empty(shape), np.empty(shape, np.uint8))
    kinds = _kinds(world)
    for part in _chunks(laser, len(instants_s)):
        poses, ranges, numbers = cast_and_name_scans(world, motion, laser, instants_s[part])
        truth.world_T_laser[part], truth.ranges_m[part], truth.hits[part] = poses, ranges, kinds[numbers]
    return truth


def cast_scans(world: World, motion: Motion, laser: LaserModel, instants_s: FloatArray) -> FloatArray:
    """True ranges (S, B) in double precision, inf beyond the laser's range: no noise, no rounding."""
    return cast_and_name_scans(world, motion, laser, instants_s)[1]


def sense(
    world: World,
    motion: Motion,
    laser: LaserModel,
    instants_s: FloatArray,
    rng: np.random.Generator,
    edge_rng: np.random.Generator,
) -> Iterator[Float32Array]:
    """Ranges (B,) of each scan: every beam cast from the pose at its own instant, then the sensor's faults."""
    for part in _chunks(laser, len(instants_s)):
        _, true_ranges, numbers = cast_and_name_scans(world, motion, laser, instants_s[part])
        if laser.mixed_share > 0.0:
            true_ranges = _mixed(true_ranges, numbers, laser.mixed_share, edge_rng)
        yield from _measured(true_ranges, laser, rng)


def _chunks(laser: LaserModel, scans: int) -> Iterator[slice]:
    per_chunk = max(1, _CHUNK_BEAMS // laser.laser.angles_rad.shape[0])
    for first in range(0, scans, per_chunk):
        yield slice(first, first + per_chunk)


def cast_and_name_scans(
    world: World, motion: Motion, laser: LaserModel, instants_s: FloatArray
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Pose of the laser, true range and number of what is hit, at each beam."""
    spec = laser.laser
    times = instants_s[:, None] + spec.offsets_s
    world_T_laser = se2.compose(motion.at(times), spec.body_T_laser)
    doors, people = (
        np.empty((*times.shape, len(world.doors), 4)),
        np.empty((*times.shape, len(world.people), 3)),
    )
    for k, door in enumerate(world.doors):
        doors[..., k, :] = door.at(times)
    for k, person in enumerate(world.people):
        people[..., k, :] = person.at(times)
    ranges, numbers = cast_and_name(
        *(world_T_laser, spec.angles_rad, world.segments, world.min_cos, world.circles),
        *(doors, people, spec.range_max_m, world.grid),
    )
    return world_T_laser, ranges, numbers


def _kinds(world: World) -> npt.NDArray[np.uint8]:
    """What the ray caster's numbers stand for; the last is that of -1, nothing."""
    segments = np.where(world.min_cos > 0.0, HIT_KINDS.index("glass"), HIT_KINDS.index("wall"))
    counts = {
        "pillar": len(world.circles),
        "door": len(world.doors),
        "person": len(world.people),
        "nothing": 1,
    }
    others = [np.full(count, HIT_KINDS.index(kind)) for kind, count in counts.items()]
    return np.concatenate([segments, *others]).astype(np.uint8)


def _mixed(ranges: FloatArray, numbers: IntArray, share: float, rng: np.random.Generator) -> FloatArray:
    """Beams beside an edge see partly this, partly that: a range anywhere between, for ``share`` of them."""
    with np.errstate(invalid="ignore"):  # inf - inf is no edge
        edge = np.abs(np.diff(ranges, axis=1)) > _EDGE_M
    edge &= np.diff(numbers, axis=1) != 0  # one wall seen at a slant has none
    edge &= np.isfinite(ranges[:, 1:]) & np.isfinite(ranges[:, :-1])
    scans, beams = np.nonzero(edge)
    side = rng.integers(0, 2, len(scans))  # which of the two beams is the mixed one
    chosen = rng.random(len(scans)) < share
    between = rng.random(len(scans))
    near, far = ranges[scans, beams], ranges[scans, beams + 1]
    out = ranges.copy()
    out[scans[chosen], (beams + side)[chosen]] = (near + between * (far - near))[chosen]
    return out


def _measured(true_ranges: FloatArray, laser: LaserModel, rng: np.random.Generator) -> Float32Array:
    spec = laser.laser
    ranges = true_ranges
    if laser.noise:
        ranges = ranges + rng.normal(0.0, spec.range_sigma_m, ranges.shape)
    if laser.range_step_m > 0.0:
        ranges = np.rint(ranges / laser.range_step_m) * laser.range_step_m
    nothing = np.inf if laser.no_return_is_inf else np.nan
    ranges = np.where(ranges >= spec.range_max_m, nothing, ranges)
    ranges = np.where(ranges < spec.range_min_m, np.nan, ranges)
    if laser.error_share > 0.0:
        ranges = np.where(rng.random(ranges.shape) < laser.error_share, np.nan, ranges)
    return ranges.astype(np.float32)
