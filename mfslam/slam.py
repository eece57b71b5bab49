"""The engine: feed messages in log order, ask for the state, finish. The only room where stages meet."""

from __future__ import annotations

import time
from array import array
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import numpy as np

from mfslam import refine, se2, trajectory
from mfslam.adjustment import AdjustedInformation, ScanPoints
from mfslam.config import Config
from mfslam.deskew import acceleration_lever_s2, deskew, reference_offset_s
from mfslam.frontend import Frontend
from mfslam.graph import PoseGraph, scan_covariances
from mfslam.kernels import poses
from mfslam.loops import LoopCloser
from mfslam.memory import give_memory_back
from mfslam.motion import MotionSources
from mfslam.observability import torn_covariances
from mfslam.ranges import with_true_ranges
from mfslam.recovery import REACH_SIGMAS, reach
from mfslam.refine import HARDLY_ANYTHING, held_by_inertia, likely_by_inertia
from mfslam.scan_motion import ADJUSTED_SIGMAS, LEAST_SIGMAS, MATCHED_SIGMAS, SmoothMotion, smooth
from mfslam.step_records import GOOD_FIT, Keyframe, Step, trust
from mfslam.types import (
    DeskewedScan,
    Edge,
    Findings,
    FloatArray,
    IntArray,
    Message,
    MfslamError,
    Scan,
)
from mfslam.wheel_errors import WheelErrors

CPU_EVERY = 16  # keyframes: to ask for a process's CPU time costs up to 0.3 ms
NO_POINTS = DeskewedScan(0, np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0, np.int64))


@dataclass
class Clock:
    """Wall seconds per stage (asking for CPU time at every scan would itself cost time)."""

    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def time(self, stage: str) -> Iterator[None]:
        start = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[stage] = self.seconds.get(stage, 0.0) + time.perf_counter() - start


@dataclass(eq=False)
class Solution:
    """What a finished run knows.

    ``stamps_ns`` (S,), ``world_T_body`` (S, 3): the robot at every scan's stamp, in log order.
    ``world_T_reference`` (S, 3), ``twists`` (S, 6): the pose at each scan's reference instant, the
    twist there and its change per second, for re-projection. ``keyframes`` (K,): scan indices that ``edges`` number.
    ``covariances`` (S, 3, 3): of x, y and yaw of ``world_T_body``, in the world's axes, relative to the first pose.
    ``smoothed_by`` (S, 3): what of ``world_T_reference`` is no match but the smoothing after it, in its tangent.
    """

    stamps_ns: IntArray
    world_T_body: FloatArray
    world_T_reference: FloatArray
    twists: FloatArray
    keyframes: IntArray
    edges: list[Edge]
    covariances: FloatArray
    smoothed_by: FloatArray


class Slam:
    """2D laser SLAM on a stream of messages.

    >>> slam = Slam(Config())
    >>> for message in log: slam.feed(message)      # doctest: +SKIP
    >>> solution = slam.finish()                     # doctest: +SKIP
    """

    def __init__(self, config: Config) -> None:
        self.config = config
        self.findings = Findings()
        self.clock = Clock()
        self.scans: list[Scan] = []
        self.steps: list[Step] = []
        self.keyframes: list[Keyframe] = []
        self.cpu_s = array("d")  # of the process, when each keyframe was reached, as of the last CPU_EVERY
        self.graph = PoseGraph(config.graph)
        self.loops = LoopCloser(config, self.keyframes)
        self._frontend = Frontend(config)
        self._motion = MotionSources(config, self.findings)
        self._waiting: Scan | None = None
        self.information: AdjustedInformation | None = None  # of the keyframes as adjusted

    @property
    def motion(self) -> MotionSources:
        """What wheels, gyro and compass told."""
        return self._motion

    @property
    def odometry_jumps(self) -> list[int]:
        """Scans whose wheel motion was found wrong."""
        return self._motion.jumps

    @property
    def wheel_errors(self) -> WheelErrors | None:
        """What was learned of the wheels; None where there are none."""
        return self._motion.wheel_errors if self._motion.odometry.has_moved else None

    # --- feeding ------------------------------------------------------------------------------------

    def feed(self, message: Message) -> None:
        """Take the next message of the log. A scan is placed once the next one has come: by then the
        wheels have told the motion through it."""
        if isinstance(message, Scan):
            message = with_true_ranges(message, self.config.sensor)
            if self._waiting is not None:
                self._motion.expect(message, self._waiting)
            self._place_waiting()
            self._waiting = message
        self._motion.add(message)

    def _place_waiting(self) -> None:
        scan, self._waiting = self._waiting, None
        if scan is None:
            return
        with self.clock.time("front end"):
            motion = self._motion.predict(scan, self._frontend.local_T_body, self._frontend.last_step)
            index = len(self.scans)
            step = self._frontend.process(index, scan, motion)
            step.twist = motion.twist if step.twist is None else step.twist
            self.scans.append(scan)
            self.steps.append(step)
            if step.odometry_jump:
                self._motion.jumps.append(index)
        if step.is_keyframe:
            self._add_keyframe(step)

    # --- keyframes ----------------------------------------------------------------------------------

    def _add_keyframe(self, step: Step) -> None:
        with self.clock.time("graph"):
            keyframe = self._frontend.recent[-1]
            self.keyframes.append(keyframe)
            is_due = len(self.cpu_s) % CPU_EVERY == 0
            self.cpu_s.append(time.process_time() if is_due else self.cpu_s[-1])
            self.loops.add_keyframe(torn=step.blind_s > 0.0)
            if len(self.keyframes) == 1:
                self.graph.add_first(np.zeros(3))
                return
            previous = self.keyframes[-2]
            prev_T_body = poses.between(previous.local_T_body, keyframe.local_T_body)
            edges = list(self._sequential_edges(previous, keyframe, step))
            self.graph.add_keyframe(prev_T_body, edges)
            torn = step.blind_s > 0.0
            likely = edges[:1] if torn else edges
            if step.unseen is not None:
                # where nothing is seen, loops are sought where the robot likely is: all that inertia allows looks alike
                likely = [*edges, replace(edges[0], information=likely_by_inertia(step.unseen))]
            self.loops.skeleton.add_step(likely, self.graph.standing_poses(), torn)
        if self.loops.due():
            self._close_loops()

    def _sequential_edges(self, previous: Keyframe, keyframe: Keyframe, step: Step) -> Iterator[Edge]:
        """Scan match, wheels and heading between a keyframe and the one before."""
        j = len(self.keyframes) - 1
        i = j - 1
        if step.blind_s > 0.0:
            yield from self._edges_over_gap(i, j, step)
            return
        assert step.match is not None
        prev_T_body = poses.between(previous.local_T_body, keyframe.local_T_body)
        a, b = previous.scan_index, keyframe.scan_index
        information = trust(step.match) * step.match.information
        if self._motion.has_wheels(a, b):
            held = information + HARDLY_ANYTHING
        else:
            held = held_by_inertia(information, step.unseen)
        yield Edge("scan", i, j, prev_T_body, held)
        if step.match.by_ends is not None:
            yield Edge("ends", i, j, prev_T_body, step.match.by_ends)
        sure = step.match.inlier_ratio > GOOD_FIT
        yield from self._motion.edges(i, j, a, b, prev_T_body, step.match.information, sure)

    def _edges_over_gap(self, i: int, j: int, step: Step) -> Iterator[Edge]:
        """What ties a scan to the keyframe before when nobody watched the robot between: its reach, and, as
        refutable as a loop, where it was found again."""
        prev_T_body = poses.between(self.keyframes[i].local_T_body, self.keyframes[j].local_T_body)
        half_m, half_rad = reach(step.blind_s)
        sigmas = np.array([half_m, half_m, half_rad]) / REACH_SIGMAS
        yield Edge("scan", i, j, prev_T_body, np.diag(sigmas**-2.0))
        if step.match is not None:
            yield Edge("loop", i, j, prev_T_body, step.match.information)
        what = "found again by its scan" if step.found else "a new map begins here, which only loops can join"
        self.findings.add(
            "lost-between-scans",
            f"nothing tells how the robot moved, and no scan fits: {what}",
            f"{step.blind_s:.1f} s before {self.scans[-1].stamp_ns * 1e-9:.6f} s",
        )

    def _close_loops(self) -> None:
        with self.clock.time("graph"):
            world_T_body = self.graph.rough_poses()
        with self.clock.time("loop closure"):
            sigma_m = self.scans[-1].laser.range_sigma_m
            loops = self.loops.search(world_T_body, sigma_m)
            for loop in loops:
                self.loops.skeleton.add_loop(loop.edge(), world_T_body)
        for loop in loops:
            self.graph.add_edge(loop.edge())
        if loops:
            self._settle_disputes()

    def _settle_disputes(self) -> None:
        """Loops that got in and stand against others are taken out while mapping."""
        with self.clock.time("graph"):
            out, back = self.graph.settle_disputes()
        poses_now = self.graph.standing_poses()
        if out:
            self.loops.skeleton.without(out, poses_now)
        for edge in back:
            self.loops.skeleton.add_loop(edge, poses_now)
        self.loops.statistics.taken_out += len(out)
        self.loops.statistics.brought_back += len(back)

    # --- the end ------------------------------------------------------------------------------------

    def place_last(self) -> None:
        """Place the scan that waits for the one after it."""
        self._place_waiting()

    def finish(self, tell: Callable[[str], None] = lambda _: None) -> Solution:
        """Solve the whole graph robustly, then, deskewed with the optimised motion, adjust all keyframes and walls.

        ``tell`` is given the name of each stage as it starts. Raises MfslamError without any scan.
        """
        self._place_waiting()
        if not self.scans:
            raise MfslamError("no scans: nothing to map")
        self._motion.settle_times()
        tell("solving the graph")
        with self.clock.time("final solve"):
            edges = self.graph.optimize(self._motion.revised(self.graph.edges_to_judge()))
        self.loops.release()
        if self.config.refine.passes and len(self.keyframes) > 1:
            edges = self._adjust(edges, tell)
            give_memory_back()
        else:
            with self.clock.time("final solve"):
                edges = self.graph.optimize_satisfied(edges)
        tell("placing the scans between keyframes")
        with self.clock.time("trajectory"):
            return self._solution(edges, localise=self.config.refine.localise)

    def solution_so_far(self) -> Solution:
        """The solution as it stands, without solving or refining any further."""
        return self._solution(self.graph.live_edges())

    def trajectory(self, world_T_keyframe: FloatArray) -> FloatArray:
        """(S, 3) world_T_body of every scan placed so far, at its stamp, with keyframes (K, 3) at these poses."""
        world_T_reference = self._scan_poses(world_T_keyframe)
        offsets = self._reference_offsets_s()
        if not offsets.any():
            return world_T_reference
        return se2.compose(world_T_reference, self._smooth(world_T_reference).relative(-offsets))

    def _reference_offsets_s(self) -> FloatArray:
        """(S,) from the scans' stamps, read on the wheels' clock, to their reference instants."""
        offsets_s = np.array([reference_offset_s(s.laser) for s in self.scans])
        drift = self.config.sensor.clock_drift
        if drift != 0.0 and self.scans[0].odom_T_body is None:
            offsets_s -= drift / (1.0 - drift) * (np.array(self._motion.times_s) - offsets_s)
        return offsets_s

    def thin_keyframes(self, spacing: float) -> None:
        """Keyframes this many times as far apart as configured from here on."""
        self._frontend.spacing = spacing

    def release(self) -> None:
        """Give back what only the matching needed; the solution, the scans and the statistics stay."""
        self.graph.release()
        self.loops.release()
        for keyframe in self.keyframes:
            keyframe.cloud = NO_POINTS
        for step in self.steps:
            step.match = None

    def _adjust(self, edges: list[Edge], tell: Callable[[str], None]) -> list[Edge]:
        config, motion = self.config, self._motion
        refinement = refine.Refinement(
            config, edges, motion.wheel_steps, motion.wheel_errors, self.scans[0].laser.range_sigma_m
        )
        for _ in range(config.refine.passes):
            tell("adjusting all keyframes and their walls together")
            with self.clock.time("adjustment"):
                refinement.forget()
                world_T_keyframe = self.graph.poses()
                motions = self._smooth(self._scan_poses(world_T_keyframe)).twists
                scans = [self.scans[k.scan_index] for k in self.keyframes]
                points = ScanPoints.of(
                    self._deskewed(motions),
                    sum(scan.ranges_m.size for scan in scans),
                    np.array([scan.laser.body_T_laser[:2] for scan in scans]),
                    (scan.laser.range_max_m - scan.ranges_m for scan in scans),
                )
                for k, keyframe in enumerate(self.keyframes):
                    keyframe.cloud = points.scan(k)
                give_memory_back()
                world_T_keyframe = refinement.round(points, world_T_keyframe)
                if len(refinement.wheels):
                    motion.wheel_errors.found(refinement.wheels.mean_errors, refinement.wheels.share)
                del points  # keyframes have their own views, until they are deskewed anew
                edges = self.graph.place(world_T_keyframe, motion.revised(edges))
        self.information = refinement.information()
        return edges

    def _deskewed(self, motions: FloatArray) -> Iterator[DeskewedScan]:
        """The keyframes deskewed with ``motions`` (S, 6) of all scans; what was made of them before is dropped."""
        for keyframe in self.keyframes:
            keyframe.cloud = NO_POINTS
        for keyframe in self.keyframes:
            n = keyframe.scan_index
            yield deskew(
                self.scans[n], motions[n], self.config.deskew, self.config.icp.point_spacing_m, doubtful=True
            )

    def _variances(self, motion: SmoothMotion, offsets_s: FloatArray) -> FloatArray:
        """(S, 3) of poses at the scans' stamps as smoothed, and as their scans may be bent by an acceleration not known."""
        levers_s2 = np.array([acceleration_lever_s2(s.laser) for s in self.scans])
        bent = np.square(levers_s2[:, None]) * motion.covariances[:, :, 2, 2]
        return np.asarray(motion.variances_at(-offsets_s) + bent)

    def _scan_poses(self, world_T_keyframe: FloatArray) -> FloatArray:
        local = np.array([step.local_T_body for step in self.steps])
        index = np.array([k.scan_index for k in self.keyframes], dtype=np.int64)
        torn = np.array([self.steps[n].blind_s > 0.0 for n in index], dtype=np.bool_)
        return trajectory.spread_corrections(local, index, world_T_keyframe, torn)

    def _smooth(self, world_T_reference: FloatArray, sigmas: FloatArray | None = None) -> SmoothMotion:
        """A smooth trajectory through poses (S, 3) of all scans; ``sigmas`` (S, 3) of those between keyframes."""
        index = np.array([k.scan_index for k in self.keyframes], dtype=np.int64)
        variances = np.square(np.tile(MATCHED_SIGMAS, (len(self.scans), 1)) if sigmas is None else sigmas)
        own = None if self.information is None else self.information.single_variances
        variances[index] = ADJUSTED_SIGMAS**2 if own is None else own + LEAST_SIGMAS**2
        times_s, late_s = np.array(self._motion.times_s), self._motion.odometry.backwards_s
        if late_s > 0.0:  # stamps that lie: a robot that moves was elsewhere at that time
            speeds = trajectory.twists_over(times_s, world_T_reference, times_s, times_s, 2.0 * late_s)
            variances += np.square(late_s * speeds)
        begins = np.array([step.blind_s > 0.0 for step in self.steps], dtype=np.bool_)
        if late_s == 0.0:  # in bursts; stamps that go back are held, and uncertain as above
            begins[1:] |= trajectory.faster_than_driven(times_s, world_T_reference, self.config.odometry)
        return smooth(times_s, world_T_reference, variances, begins)

    def _solution(self, edges: list[Edge], localise: bool = False) -> Solution:
        world_T_reference = self._scan_poses(self.graph.poses())
        motion = self._smooth(world_T_reference)
        keyframes = np.array([k.scan_index for k in self.keyframes], dtype=np.int64)
        smoothed_by = np.zeros_like(world_T_reference)
        if localise and len(self.keyframes) > 1:
            world_T_reference, sigmas = refine.localise_between(
                self.scans, motion.twists, world_T_reference, self.keyframes, self.config
            )
            motion = self._smooth(world_T_reference, sigmas)
            if self._motion.odometry.backwards_s == 0.0:
                smoothed_by = motion.off
                world_T_reference = se2.compose(world_T_reference, se2.exp(smoothed_by))
                edges = self.graph.place(world_T_reference[keyframes], edges)
        offsets = self._reference_offsets_s()
        reference_T_stamp = motion.relative(-offsets)
        world_T_body = se2.compose(world_T_reference, reference_T_stamp)
        if offsets.any():
            edges = edges_at_stamps(edges, reference_T_stamp[keyframes])
        marginals = None
        if self.information is not None:
            self.information.take_smoothed(self._variances(motion, offsets)[keyframes])
            # walls that fit on both sides of a tear may be others that look alike
            marginals = self.information.marginals() + torn_covariances(world_T_body[keyframes], edges)
        return Solution(
            stamps_ns=np.array([s.stamp_ns for s in self.scans], dtype=np.int64),
            world_T_body=world_T_body,
            world_T_reference=world_T_reference,
            twists=motion.twists,
            keyframes=keyframes,
            edges=edges,
            covariances=scan_covariances(world_T_body, keyframes, edges, marginals),
            smoothed_by=smoothed_by,
        )


def edges_at_stamps(edges: list[Edge], reference_T_stamp: FloatArray) -> list[Edge]:
    """Edges between reference instants, carried to the stamps of their keyframes.

    ``reference_T_stamp`` (K, 3): motion of each keyframe from the one to the other. The information
    follows: a perturbation xi at the stamp is Ad(reference_T_stamp) xi at the reference instant.
    """
    out = []
    for edge in edges:
        if edge.kind == "heading":
            out.append(edge)
            continue
        a, b = reference_T_stamp[edge.i], reference_T_stamp[edge.j]
        carried = poses.compose(poses.between(a, edge.i_T_j), b)
        adjoint = se2.adjoint(b)
        out.append(replace(edge, i_T_j=carried, information=adjoint.T @ edge.information @ adjoint))
    return out
