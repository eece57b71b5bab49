"""Drive a robot through a world and write down what its sensors say, and what was true."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from drivers.simulator.faults import Faults, awake, clock_shift_ns, outside, spoilt_stamps
from drivers.simulator.motion import Motion
from drivers.simulator.readings import Timed, gyro_messages, seconds_since, wheel_messages
from drivers.simulator.robot import RobotModel, drive
from drivers.simulator.sensing import cast_scans, sense
from drivers.simulator.sensors import LaserModel
from drivers.simulator.world import World
from mfslam.types import FloatArray, IntArray, Message, MfslamError, Scan

__all__ = ["START_NS", "Faults", "Simulation", "cast_scans", "simulate"]

START_NS = 1_600_000_000_000_000_000


@dataclass(frozen=True, eq=False)
class Simulation:
    """A simulated log and the truth.

    ``messages``: in log order (as they would arrive). ``truth_stamps_ns`` (S,): the scans' stamps as the
    log gives them; ``truth_world_T_body`` (S, 3): the true pose at those stamps, by the wheels' clock, or
    where faults spoil the stamps (jitter, bursts, clock jumps), at what they would have been without.
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
        return self.motion.at(seconds_since(self.start_ns, stamps_ns))

    @property
    def scans(self) -> list[Scan]:
        return [m for m in self.messages if isinstance(m, Scan)]


def without_pose(message: Message) -> Message:
    """As in a ROS log: scans carry no pose of the wheels, which have messages of their own."""
    return replace(message, odom_T_body=None) if isinstance(message, Scan) else message


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
    wheel_rng, laser_rng, gyro_rng, loss_rng, stamp_rng, encoder_rng, edge_rng = np.random.default_rng(
        seed
    ).spawn(7)
    instants = _scan_instants(laser, motion)
    kept = outside(instants, faults.scan_gaps_s) & (loss_rng.random(len(instants)) >= faults.drop_share)
    instants = instants[kept]
    honest = start_ns + np.rint((instants + _late_s(laser, instants)) * 1e9).astype(np.int64)
    stamps, handed_over = spoilt_stamps(honest, faults, stamp_rng)
    reported = laser.reported if laser.reported is not None else laser.laser
    arrivals = handed_over + round(float(np.max(reported.offsets_s)) * 1e9)
    begun_s = np.minimum(instants, seconds_since(start_ns, stamps))
    whole = awake(begun_s, seconds_since(start_ns, arrivals), faults)
    instants, honest, stamps, arrivals = instants[whole], honest[whole], stamps[whole], arrivals[whole]
    if not len(instants):
        raise MfslamError(f"{world.name}: no scan fits into {motion.duration_s:g} s of driving")
    timeline, odom_at_scans = wheel_messages(
        motion, robot, faults, stamps, arrivals, start_ns, wheel_rng, encoder_rng
    )
    timeline += gyro_messages(motion, robot, faults, start_ns, gyro_rng)
    told_stamps = stamps + clock_shift_ns(seconds_since(start_ns, stamps), faults)
    ranges = sense(world, motion, laser, instants, laser_rng, edge_rng)
    for i, (arrival, stamp, row) in enumerate(
        zip(arrivals.tolist(), told_stamps.tolist(), ranges, strict=True)
    ):
        pose = odom_at_scans[i] if odom_at_scans is not None else None
        timeline.append((arrival, Scan(stamp, row, reported, pose)))
    truth = motion.at(seconds_since(start_ns, honest))
    return Simulation(_in_order(timeline), told_stamps, truth, instants, motion, start_ns)


def _late_s(laser: LaserModel, instants_s: FloatArray) -> FloatArray:
    """What stamps say beyond the instant of the scan."""
    return instants_s * laser.clock_drift + laser.stamp_delay_s


def _in_order(timeline: list[Timed]) -> list[Message]:
    timeline.sort(key=lambda item: item[0])  # stable: at one instant wheels come before scans
    return [message for _, message in timeline]


def _scan_instants(laser: LaserModel, motion: Motion) -> FloatArray:
    """Instants (S,), whole ns, of all scans whose every beam falls into the motion."""
    first = max(0.0, -float(np.min(laser.laser.offsets_s)))
    room = motion.duration_s - first - float(np.max(laser.laser.offsets_s))
    count = max(math.floor(room / laser.period_s + 1e-9) + 1, 0)
    return np.asarray(np.rint((first + np.arange(count) * laser.period_s) * 1e9) * 1e-9)
