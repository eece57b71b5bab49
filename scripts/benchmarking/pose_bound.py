"""How well any estimator could know the poses of a simulated log: the bound of Cramer and Rao.

It knows the walls, the noise of ranges and wheels and how the robot changes its motion (white noise on the jerk, of the size that
the true motion shows), and takes every beam at its own instant. What edges of walls tell, a beam that just meets one or just
misses it, is left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.simulator import LaserModel, RobotModel, Simulation, World
from drivers.simulator.sensing import cast_and_name_scans
from mfslam import se2
from mfslam.scan_motion import smooth
from mfslam.types import FloatArray

NODE_S = 0.02  # beams count at the nearest of instants so far apart
CHUNK_BEAMS = 200_000
LEAST_SLANT = 0.02  # of a wall to a beam
UNKNOWN, NO_SIDEWAYS = 100.0, 1e-10  # variances
X, Y, TURN, SPEED, RATE, PUSH, SPIN = range(
    7
)  # errors of a pose in its tangent, of its speeds, of their changes


@dataclass(frozen=True)
class Bound:
    """Root mean squares over all scans, at their stamps."""

    translation_m: float
    rotation_deg: float


def bound_of(world: World, robot: RobotModel, laser: LaserModel, simulation: Simulation) -> Bound:
    """Of all scans together. Doors and people that move tell nothing."""
    times_s = np.arange(0.0, simulation.motion.duration_s + NODE_S, NODE_S)
    nodes = simulation.motion.at(times_s)
    seen = _information_of_beams(world, laser, simulation, nodes)
    covariances = _smoothed(nodes, seen, _wheel_variances(robot, simulation, times_s), _jerk(simulation))
    at_stamps = covariances[np.rint(simulation.instants_s / NODE_S).astype(np.int64)]
    return Bound(
        float(np.sqrt(np.mean(at_stamps[:, X, X] + at_stamps[:, Y, Y]))),
        float(np.degrees(np.sqrt(np.mean(at_stamps[:, TURN, TURN])))),
    )


def _jerk(simulation: Simulation) -> tuple[float, float]:
    """Spectral densities along x and of the turn."""
    times_s = np.arange(0.0, simulation.motion.duration_s, 0.1)
    exact, begins = np.full((len(times_s), 3), 1e-10), np.zeros(len(times_s), np.bool_)
    jerk = smooth(times_s, simulation.motion.at(times_s), exact, begins).jerk
    return float(jerk[0]), float(jerk[2])


def _information_of_beams(
    world: World, laser: LaserModel, simulation: Simulation, nodes: FloatArray
) -> FloatArray:
    """(N, 3, 3) of the pose at every node, by the beams that are sensed about then."""
    out = np.zeros((len(nodes), 3, 3))
    spec, standing = laser.laser, len(world.segments) + len(world.circles)
    variance = spec.range_sigma_m**2 + laser.range_step_m**2 / 12.0
    along = world.segments[:, 2:] - world.segments[:, :2]
    of_segments = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.hypot(*along.T)[:, None]
    per_chunk = max(1, CHUNK_BEAMS // len(spec.angles_rad))
    for first in range(0, len(simulation.instants_s), per_chunk):
        instants_s = simulation.instants_s[first : first + per_chunk]
        poses, ranges_m, numbers = cast_and_name_scans(world, simulation.motion, laser, instants_s)
        hit = (numbers >= 0) & (numbers < standing)
        heading = (poses[..., 2] + spec.angles_rad)[hit]
        beam = np.stack([np.cos(heading), np.sin(heading)], axis=1)
        points, number = poses[hit][:, :2] + ranges_m[hit][:, None] * beam, numbers[hit]
        round_ = number >= len(world.segments)
        normals = of_segments[np.where(round_, 0, number)]
        outward = points[round_] - world.circles[number[round_] - len(world.segments), :2]
        normals[round_] = outward / np.hypot(*outward.T)[:, None]
        slant = np.sum(normals * beam, axis=1)
        told = np.abs(slant) > LEAST_SLANT
        times_s = np.broadcast_to(instants_s[:, None] + spec.offsets_s, hit.shape)[hit][told]
        node = np.minimum(np.rint(times_s / NODE_S).astype(np.int64), len(nodes) - 1)
        # a point of the beam moves with the robot as it stands at the node
        c, s = np.cos(nodes[node, 2]), np.sin(nodes[node, 2])
        (n_x, n_y), (d_x, d_y) = normals[told].T, (points[told] - nodes[node, :2]).T
        across, sideways = c * n_x + s * n_y, -s * n_x + c * n_y
        by_turn = n_y * d_x - n_x * d_y
        of_range = np.stack([across, sideways, by_turn], axis=1) / slant[told][:, None]
        np.add.at(out, node, of_range[:, :, None] * of_range[:, None, :] / variance)
    return out


def _wheel_variances(robot: RobotModel, simulation: Simulation, times_s: FloatArray) -> FloatArray:
    """(N - 1, 2) of the mean speed and yaw rate between nodes as wheels tell them, whose systematic errors are known."""
    forward_m, turned_rad = simulation.motion.travel(times_s)
    half_m = 0.5 * robot.wheels.track_m * (1.0 + robot.track_error) * robot.turning_track_factor
    rolled_m = np.abs(np.diff(forward_m - half_m * turned_rad)) + np.abs(
        np.diff(forward_m + half_m * turned_rad)
    )
    tick_m = 2.0 * np.pi * robot.wheels.radius_left_m / robot.wheels.ticks_per_turn
    both = robot.slip_m_per_sqrt_m**2 * rolled_m + 4.0 * tick_m**2 / 12.0
    return np.stack([both / 4.0, both / (4.0 * half_m**2)], axis=1) / NODE_S**2


def _smoothed(
    nodes: FloatArray, seen: FloatArray, wheel_variances: FloatArray, jerk: tuple[float, float]
) -> FloatArray:
    """(N, 7, 7) covariances of a Kalman filter and the smoother of Rauch and others."""
    count, t = len(nodes), NODE_S
    carry = np.tile(np.eye(7), (count - 1, 1, 1))
    carry[:, :3, :3] = se2.adjoint(se2.inverse(se2.between(nodes[:-1], nodes[1:])))
    noise = np.zeros((7, 7))
    noise[Y, Y] = NO_SIDEWAYS
    powers = np.array(
        [
            [t**5 / 20.0, t**4 / 8.0, t**3 / 6.0],
            [t**4 / 8.0, t**3 / 3.0, t**2 / 2.0],
            [t**3 / 6.0, t**2 / 2.0, t],
        ]
    )
    for axis, density in zip(([X, SPEED, PUSH], [TURN, RATE, SPIN]), jerk, strict=True):
        carry[:, axis[0], axis[1]] = carry[:, axis[1], axis[2]] = t
        carry[:, axis[0], axis[2]] = 0.5 * t * t
        noise[np.ix_(axis, axis)] += density * powers
    told = np.zeros((count, 7, 7))
    told[:, :3, :3] = seen
    told[:-1, SPEED, SPEED], told[:-1, RATE, RATE] = (1.0 / wheel_variances).T
    before, after = np.empty((count, 7, 7)), np.empty((count, 7, 7))
    covariance = UNKNOWN * np.eye(7)
    for n in range(count):
        if n:
            covariance = carry[n - 1] @ covariance @ carry[n - 1].T + noise
        before[n] = covariance
        covariance = np.linalg.inv(np.linalg.inv(covariance) + told[n])
        after[n] = covariance
    for n in range(count - 2, -1, -1):
        gain = after[n] @ carry[n].T @ np.linalg.inv(before[n + 1])
        after[n] += gain @ (after[n + 1] - before[n + 1]) @ gain.T
    return after
