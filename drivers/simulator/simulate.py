"""Drive a robot through a world and write down what its sensors say, and what was true."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from drivers.simulator.motion import Motion
from drivers.simulator.raycast import cast_and_name
from drivers.simulator.robot import RobotModel, dead_reckoning, drive, encoder_ticks, wheel_angles
from drivers.simulator.sensors import LaserModel
from drivers.simulator.world import World
from mfslam import se2
from mfslam.types import (
    Float32Array,
    FloatArray,
    Imu,
    IntArray,
    Message,
    MfslamError,
    Odometry,
    Scan,
    WheelAngles,
    WheelTicks,
)

START_NS = 1_600_000_000_000_000_000
_CHUNK_BEAMS = 200_000  # beams cast at once: bounds the memory


@dataclass(frozen=True)
class Faults:
    """What goes wrong on the way into the log. Times in s from the start, intervals (from, to).

    ``odometry_jumps``: (time, x, y, theta): from then on the odometry frame is displaced, in the body
    frame of that instant. ``drop_share``: share of scans lost, one by one.
    """

    scan_gaps_s: tuple[tuple[float, float], ...] = ()
    drop_share: float = 0.0
    odometry_gaps_s: tuple[tuple[float, float], ...] = ()
    odometry_jumps: tuple[tuple[float, float, float, float], ...] = ()


@dataclass(frozen=True, eq=False)
class Simulation:
    """A simulated log and the truth.

    ``messages``: in log order (as they would arrive). ``truth_stamps_ns`` (S,): the scans' stamps as the
    log gives them; ``truth_world_T_body`` (S, 3): the true pose at those stamps, by the wheels' clock.
    ``instants_s`` (S,): when each scan was really sensed, from the start of ``motion``.
    """

    messages: list[Message]
    truth_stamps_ns: IntArray
    truth_world_T_body: FloatArray
    instants_s: FloatArray
    motion: Motion
    start_ns: int

    def truth_at(self, stamps_ns: IntArray) -> FloatArray:
        """True world_T_body (..., 3) at any stamps (...) of the wheels' clock, int ns."""
        return self.motion.at(_seconds(stamps_ns, self.start_ns))

    @property
    def scans(self) -> list[Scan]:
        return [m for m in self.messages if isinstance(m, Scan)]


def simulate(
    world: World,
    robot: RobotModel,
    laser: LaserModel,
    *,
    seed: int = 0,
    motion: Motion | None = None,
    faults: Faults | None = None,
    start_ns: int = START_NS,
) -> Simulation:
    """Everything the robot's log would hold, from the first scan to the last, noise drawn from ``seed``.

    ``motion``: the true motion; by default the robot drives the world's path. Noise of wheels, laser and
    gyro comes from separate streams: changing one leaves the others as they were.
    """
    motion = motion if motion is not None else drive(world, robot)
    faults = faults if faults is not None else Faults()
    wheel_rng, laser_rng, gyro_rng, loss_rng = np.random.default_rng(seed).spawn(4)
    instants = _scan_instants(laser, motion)
    kept = _outside(instants, faults.scan_gaps_s) & (loss_rng.random(len(instants)) >= faults.drop_share)
    instants = instants[kept]
    if not len(instants):
        raise MfslamError(f"{world.name}: no scan fits into {motion.duration_s:g} s of driving")
    late_s = instants * laser.clock_drift + laser.stamp_delay_s
    stamps = start_ns + np.rint((instants + late_s) * 1e9).astype(np.int64)
    odometry, odom_at_scans = _wheel_messages(motion, robot, faults, stamps, start_ns, wheel_rng)
    gyro = _gyro_messages(motion, robot, start_ns, gyro_rng)
    reported = laser.reported if laser.reported is not None else laser.laser
    last_beam_ns = round(float(np.max(reported.offsets_s)) * 1e9)
    timeline: list[tuple[int, Message]] = [(m.stamp_ns, m) for m in (*odometry, *gyro)]
    ranges = _sense(world, motion, laser, instants, laser_rng)
    for i, (stamp, row) in enumerate(zip(stamps.tolist(), ranges, strict=True)):
        pose = odom_at_scans[i] if odom_at_scans is not None else None
        timeline.append((stamp + last_beam_ns, Scan(stamp, row, reported, pose)))
    timeline.sort(key=lambda item: item[0])  # stable: at one instant wheels come before scans
    truth = motion.at(_seconds(stamps, start_ns))
    return Simulation([m for _, m in timeline], stamps, truth, instants, motion, start_ns)


def _seconds(stamps_ns: IntArray, start_ns: int) -> FloatArray:
    since = np.asarray(stamps_ns, dtype=np.int64) - start_ns  # subtract first: exact
    return since.astype(np.float64) * 1e-9


def _scan_instants(laser: LaserModel, motion: Motion) -> FloatArray:
    """Instants (S,), whole ns, of all scans whose every beam falls into the motion."""
    first = max(0.0, -float(np.min(laser.laser.offsets_s)))
    room = motion.duration_s - first - float(np.max(laser.laser.offsets_s))
    count = max(math.floor(room / laser.period_s + 1e-9) + 1, 0)
    return np.asarray(np.rint((first + np.arange(count) * laser.period_s) * 1e9) * 1e-9)


def _outside(times: FloatArray, gaps: tuple[tuple[float, float], ...]) -> np.ndarray:
    keep = np.ones(times.shape, dtype=bool)
    for start, end in gaps:
        keep &= (times < start) | (times >= end)
    return keep


def _sense(
    world: World, motion: Motion, laser: LaserModel, instants: FloatArray, rng: np.random.Generator
) -> Iterator[Float32Array]:
    """Ranges (B,) of each scan: every beam cast from the pose at its own instant, then the sensor's faults."""
    per_chunk = max(1, _CHUNK_BEAMS // laser.laser.angles_rad.shape[0])
    for i in range(0, len(instants), per_chunk):
        true_ranges = cast_scans(world, motion, laser, instants[i : i + per_chunk])
        yield from _measured(true_ranges, laser, rng)


def cast_scans(world: World, motion: Motion, laser: LaserModel, instants_s: FloatArray) -> FloatArray:
    """True ranges (S, B) in double precision, inf beyond the laser's range: no noise, no rounding."""
    spec = laser.laser
    times = instants_s[:, None] + spec.offsets_s
    doors = [door.at(times) for door in world.doors]
    people = [person.at(times) for person in world.people]
    no_doors, no_people = np.empty((*times.shape, 0, 4)), np.empty((*times.shape, 0, 3))
    ranges, _ = cast_and_name(
        se2.compose(motion.at(times), spec.body_T_laser),
        spec.angles_rad,
        world.segments,
        world.min_cos,
        world.circles,
        np.stack(doors, axis=-2) if doors else no_doors,
        np.stack(people, axis=-2) if people else no_people,
        spec.range_max_m,
        world.grid,
    )
    return np.asarray(ranges)


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


def _wheel_messages(
    motion: Motion,
    robot: RobotModel,
    faults: Faults,
    scan_stamps: IntArray,
    start_ns: int,
    rng: np.random.Generator,
) -> tuple[list[Message], FloatArray | None]:
    """Wheel messages in order, and odom_T_body (S, 3) at the scans where the log carries poses."""
    if robot.odometry == "none":
        return [], None
    own = np.array([start_ns], dtype=np.int64)
    if robot.encoder_rate_hz is not None:
        own = start_ns + _reading_ns(motion, robot.encoder_rate_hz)
    stamps = np.unique(np.concatenate([own, scan_stamps]))
    times = _seconds(stamps, start_ns)
    angles = wheel_angles(motion, robot, times, rng)
    ticks = encoder_ticks(angles, robot.wheels)
    told = np.isin(stamps, scan_stamps if robot.encoder_rate_hz is None else own)
    if robot.odometry == "pose":  # what a scan carries itself, the stream must not lack
        told |= np.isin(stamps, scan_stamps)
    told &= _outside(times, faults.odometry_gaps_s)
    if robot.odometry == "ticks":
        return [WheelTicks(t, int(a), int(b)) for t, (a, b) in _pick(stamps, ticks, told)], None
    if robot.odometry == "angles":
        return [WheelAngles(t, float(a), float(b)) for t, (a, b) in _pick(stamps, angles, told)], None
    poses = _displaced(dead_reckoning(ticks, robot.wheels), times, faults.odometry_jumps)
    messages: list[Message] = [Odometry(t, pose) for t, pose in _pick(stamps, poses, told)]
    return messages, poses[np.searchsorted(stamps, scan_stamps)]


def _reading_ns(motion: Motion, rate_hz: float) -> IntArray:
    """Instants of readings at an even rate, ns from the start."""
    count = math.floor(motion.duration_s * rate_hz + 1e-6) + 1
    return np.asarray(np.rint(np.arange(count) * (1e9 / rate_hz)).astype(np.int64))


def _pick(stamps: IntArray, rows: FloatArray, told: np.ndarray) -> Iterator[tuple[int, FloatArray]]:
    return zip(stamps[told].tolist(), rows[told], strict=True)


def _displaced(
    poses: FloatArray, times: FloatArray, jumps: tuple[tuple[float, float, float, float], ...]
) -> FloatArray:
    for at, *jump in sorted(jumps):
        k = int(np.searchsorted(times, at))
        if k < len(poses):
            after = se2.compose(poses[k], np.array(jump))
            poses = np.concatenate([poses[:k], se2.compose(after, se2.between(poses[k], poses[k:]))])
    return poses


def _gyro_messages(
    motion: Motion, robot: RobotModel, start_ns: int, rng: np.random.Generator
) -> list[Message]:
    if robot.gyro_rate_hz <= 0.0:
        return []
    since_ns = _reading_ns(motion, robot.gyro_rate_hz)
    times = _seconds(since_ns, 0)
    noise = rng.standard_normal((len(times), 2))
    rates = motion.twist_at(times)[:, 2] * (1.0 + robot.gyro_scale_error) + robot.gyro_bias_rad_s
    rates = rates + noise[:, 0] * robot.gyro_sigma_rad_s
    sigma = robot.compass_sigma_rad
    headings = motion.at(times)[:, 2] + robot.compass_bias_rad + noise[:, 1] * (sigma or 0.0)
    yaws: list[float | None] = [None] * len(times) if sigma is None else list(se2.wrap(headings).tolist())
    return [
        Imu(t, w, yaw) for t, w, yaw in zip((start_ns + since_ns).tolist(), rates.tolist(), yaws, strict=True)
    ]
