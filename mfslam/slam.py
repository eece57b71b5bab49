"""The engine: feed messages in log order, ask for the state, finish. The only room where stages meet."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import numpy as np

from mfslam import refine, se2, trajectory
from mfslam.config import Config
from mfslam.deskew import deskew, reference_offset_s
from mfslam.frontend import Frontend, Keyframe, PredictedMotion, Step
from mfslam.graph import PoseGraph
from mfslam.heading import HeadingTrack
from mfslam.kernels import poses
from mfslam.kinematics import WheelIntegrator
from mfslam.loops import LoopCloser
from mfslam.odometry import OdometryTrack, factor_information, is_jump
from mfslam.types import (
    Edge,
    Findings,
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

POOR_FIT, GOOD_FIT = 0.25, 0.65  # inlier ratios between which a match gains its full weight
WEAK_SIGMA_M = 0.1  # a match less sure than this along some direction is weak
# of a step that neither scan nor wheels tell (1 m, 1 rad): without it the chain of poses would break there
HARDLY_ANYTHING = np.eye(3)
INERTIA = 25.0 * np.eye(3)  # what holds a robot without wheels where its scans leave a direction open
STARTED_M, STARTED_RAD = 0.5, 0.3  # wheels that still show nothing by then are not connected
LAG_S = 0.5  # odometry older than this says nothing of a scan


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
    ``world_T_reference`` (S, 3), ``twists`` (S, 3): the pose at each scan's reference instant and the
    motion through it, for re-projection. ``keyframes`` (K,): scan indices that ``edges`` number.
    """

    stamps_ns: IntArray
    world_T_body: FloatArray
    world_T_reference: FloatArray
    twists: FloatArray
    keyframes: IntArray
    edges: list[Edge]


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
        self.graph = PoseGraph(config.graph)
        self.loops = LoopCloser(config, self.keyframes)
        self.odometry_jumps: list[int] = []
        self._frontend = Frontend(config)
        self._wheels = WheelIntegrator(config.wheels, self.findings)
        self._odometry = OdometryTrack(config.odometry)
        self._heading = HeadingTrack(config.imu)
        self._waiting: Scan | None = None
        self._times_s: list[float] = []  # reference instants, held where stamps go backwards
        self._odom_T_body: list[FloatArray | None] = []
        self._epoch_ns: int | None = None

    # --- feeding ------------------------------------------------------------------------------------

    def feed(self, message: Message) -> None:
        """Take the next message of the log. A scan is placed once the next one has come: by then the
        wheels have told the motion through it."""
        if self._epoch_ns is None:
            self._epoch_ns = message.stamp_ns
        if isinstance(message, Scan):
            self._place_waiting()
            if message.odom_T_body is not None:
                self._odometry.add(self._seconds(message.stamp_ns), message.odom_T_body)
            self._waiting = message
        elif isinstance(message, Odometry):
            self._odometry.add(self._seconds(message.stamp_ns), message.odom_T_body)
        elif isinstance(message, WheelTicks):
            self._add_wheels(self._wheels.add_ticks(message))
        elif isinstance(message, WheelAngles):
            self._add_wheels(self._wheels.add_angles(message))
        elif isinstance(message, Imu):
            self._heading.add(self._seconds(message.stamp_ns), message)

    def _add_wheels(self, odometry: Odometry) -> None:
        self._odometry.add(self._seconds(odometry.stamp_ns), odometry.odom_T_body)

    def _seconds(self, stamp_ns: int) -> float:
        assert self._epoch_ns is not None
        return (stamp_ns - self._epoch_ns) * 1e-9

    def _place_waiting(self) -> None:
        scan, self._waiting = self._waiting, None
        if scan is None:
            return
        with self.clock.time("front end"):
            motion = self._predict(scan)
            index = len(self.scans)
            step = self._frontend.process(index, scan, motion)
            self.scans.append(scan)
            self.steps.append(step)
            if step.odometry_jump:
                self.odometry_jumps.append(index)
        if step.is_keyframe:
            self._add_keyframe(step)

    # --- prediction ---------------------------------------------------------------------------------

    def _predict(self, scan: Scan) -> PredictedMotion:
        """Motion since the previous scan and through this one, from wheels and gyro where they tell."""
        laser, config = scan.laser, self.config
        stamp_s = self._seconds(scan.stamp_ns)
        reference_s = stamp_s + reference_offset_s(laser)
        start_s, end_s = stamp_s + float(laser.offsets_s.min()), stamp_s + float(laser.offsets_s.max())
        time_s = max(reference_s, self._times_s[-1]) if self._times_s else reference_s
        dt_s = time_s - self._times_s[-1] if self._times_s else 0.0
        odom = self._odometry_at(scan, reference_s) if config.odometry.use else None
        previous = self._odom_T_body[-1] if self._odom_T_body else None
        turn_rad = self._heading.turn(self._times_s[-1], time_s) if self._times_s else None
        self._times_s.append(time_s)
        self._odom_T_body.append(odom)
        step = None
        if odom is not None and previous is not None:
            step = poses.between(previous, odom)
            if is_jump(step, dt_s, config.odometry) or self._odometry.is_broken(time_s - dt_s, time_s):
                self.findings.add(
                    "odometry-jump",
                    "the wheels' pose jumps farther than a robot drives: that step was left to the scans",
                    f"{scan.stamp_ns * 1e-9:.6f} s",
                )
                self.odometry_jumps.append(len(self.scans))
                step = None
        if step is not None:
            twist = self._odometry.twist_over(start_s, end_s, config.odometry)
        elif dt_s > 0.0:
            twist = poses.log(self._frontend.last_step) / max(dt_s, 0.02)
        else:
            twist = np.zeros(3)
        if turn_rad is not None and dt_s > 0.0:
            twist = np.array([twist[0], twist[1], turn_rad / dt_s])
        return PredictedMotion(twist, dt_s, step, turn_rad)

    def _odometry_at(self, scan: Scan, reference_s: float) -> FloatArray | None:
        """Wheels' pose at the scan's reference instant; None where they say nothing (yet)."""
        track = self._odometry
        if not track.has_moved and (len(track) == 0 or self._has_left_start()):
            return None  # no wheels, or none that turn: a pose that never changes is no measurement
        if scan.odom_T_body is not None:
            offset_s = reference_offset_s(scan.laser)
            if offset_s == 0.0:
                return scan.odom_T_body
            stamp_s = self._seconds(scan.stamp_ns)
            twist = track.twist_over(stamp_s, stamp_s, self.config.odometry)
            return se2.compose(scan.odom_T_body, se2.exp(twist * offset_s))
        if not track.times_s[0] - LAG_S <= reference_s <= track.times_s[-1] + LAG_S:
            self.findings.add(
                "odometry-gap",
                "no odometry around a scan: it was placed without wheels",
                f"{scan.stamp_ns * 1e-9:.6f} s",
            )
            return None
        since_s = reference_s - track.times_s[-1]
        if since_s <= 0.0:
            return track.pose_at(reference_s)
        # the wheels have not told this instant yet: they turn on as they did, and do not stand still
        twist = track.twist_over(track.times_s[-1], track.times_s[-1], self.config.odometry)
        return se2.compose(track.odom_T_body[-1], se2.exp(twist * since_s))

    def _has_left_start(self) -> bool:
        """Whether the scans tell of a robot that drives, whatever its wheels say."""
        x, y, theta = self._frontend.local_T_body
        return math.hypot(x, y) > STARTED_M or abs(theta) > STARTED_RAD

    # --- keyframes ----------------------------------------------------------------------------------

    def _add_keyframe(self, step: Step) -> None:
        with self.clock.time("graph"):
            keyframe = self._frontend.recent[-1]
            self.keyframes.append(keyframe)
            self.loops.add_keyframe()
            if len(self.keyframes) == 1:
                self.graph.add_first(np.zeros(3))
                return
            previous = self.keyframes[-2]
            prev_T_body = poses.between(previous.local_T_body, keyframe.local_T_body)
            edges = list(self._sequential_edges(previous, keyframe, step))
            self.graph.add_keyframe(prev_T_body, edges)
            self.loops.uncertainty.add(edges[0])
        if self.loops.due():
            self._close_loops()

    def _sequential_edges(self, previous: Keyframe, keyframe: Keyframe, step: Step) -> Iterator[Edge]:
        """Scan match, wheels and heading between a keyframe and the one before."""
        j = len(self.keyframes) - 1
        i = j - 1
        assert step.match is not None
        trust = np.clip((step.match.inlier_ratio - POOR_FIT) / (GOOD_FIT - POOR_FIT), 0.02, 1.0) ** 2
        prev_T_body = poses.between(previous.local_T_body, keyframe.local_T_body)
        a, b = previous.scan_index, keyframe.scan_index
        odom_a, odom_b = self._odom_T_body[a], self._odom_T_body[b]
        least = INERTIA if odom_a is None or odom_b is None else HARDLY_ANYTHING
        yield Edge("scan", i, j, prev_T_body, trust * step.match.information + least)
        if odom_a is not None and odom_b is not None:
            wheels = poses.between(odom_a, odom_b)
            jumped = bool(self.odometry_jumps) and self.odometry_jumps[-1] > a
            # a step that nothing can drive stays out: at 1e9 m the least information still pulls
            if not (jumped and is_jump(wheels, self._times_s[b] - self._times_s[a], self.config.odometry)):
                yield Edge("odometry", i, j, wheels, factor_information(wheels, jumped, self.config.odometry))
        t0, t1 = self._times_s[a], self._times_s[b]
        turn_rad = self._heading.turn(t0, t1)
        if turn_rad is not None:
            sigma_rad = self._heading.turn_sigma(t1 - t0)
            yield Edge("heading", i, j, np.array([0.0, 0.0, turn_rad]), np.diag([0.0, 0.0, sigma_rad**-2]))
            self._heading.learn_bias(t1 - t0, turn_rad, float(prev_T_body[2]))
        compass = self._heading.compass(t1)
        if compass is not None:
            heading_rad, sigma_rad = compass
            yield Edge("heading", j, j, np.array([0.0, 0.0, heading_rad]), np.diag([0.0, 0.0, sigma_rad**-2]))

    def _close_loops(self) -> None:
        with self.clock.time("graph"):
            world_T_body = self.graph.poses()
        with self.clock.time("loop closure"):
            sigma_m = self.scans[-1].laser.range_sigma_m
            loops = self.loops.search(world_T_body, self.graph.relative_covariance, sigma_m)
        for loop in loops:
            self.graph.add_edge(loop.edge())
            self.loops.uncertainty.add(loop.edge())

    # --- the end ------------------------------------------------------------------------------------

    def finish(self, tell: Callable[[str], None] = lambda _: None) -> Solution:
        """Solve the whole graph robustly, deskew with the optimised motion, match and solve again.

        ``tell`` is given the name of each stage as it starts. Raises MfslamError without any scan.
        """
        self._place_waiting()
        if not self.scans:
            raise MfslamError("no scans: nothing to map")
        tell("solving the graph")
        with self.clock.time("final solve"):
            edges = self.graph.optimize()
        for _ in range(self.config.refine.passes if len(self.keyframes) > 1 else 0):
            tell("matching again from the optimised trajectory")
            edges = self._refine(edges)
        tell("placing the scans between keyframes")
        with self.clock.time("trajectory"):
            return self._solution(edges, localise=self.config.refine.localise)

    def solution_so_far(self) -> Solution:
        """The solution as it stands, without solving or refining any further."""
        return self._solution(self.graph.live_edges())

    def weak_directions(self, edges: list[Edge]) -> dict[str, float]:
        """Keyframe steps whose scan match leaves a direction open, so that the wheels decide there."""
        weak_m = 0.0
        count = 0
        for edge in edges:
            successive = edge.kind == "scan" and edge.j == edge.i + 1
            if successive and np.linalg.eigvalsh(edge.information[:2, :2])[0] < WEAK_SIGMA_M**-2:
                count += 1
                weak_m += math.hypot(edge.i_T_j[0], edge.i_T_j[1])
        return {"steps": count, "travelled_m": weak_m, "sigma_above_m": WEAK_SIGMA_M}

    def _refine(self, edges: list[Edge]) -> list[Edge]:
        config = self.config
        world_T_keyframe = self.graph.poses()
        with self.clock.time("second pass"):
            twists = self._twists(self._scan_poses(world_T_keyframe))
            for keyframe in self.keyframes:
                n = keyframe.scan_index
                keyframe.cloud = deskew(self.scans[n], twists[n], config.deskew, config.icp.point_spacing_m)
            pairs = refine.neighbours(world_T_keyframe, config.refine)
            sigma_m = self.scans[0].laser.range_sigma_m
            matched = refine.match_neighbours(
                [k.cloud for k in self.keyframes], world_T_keyframe, pairs, sigma_m, config.icp, config.refine
            )
        with self.clock.time("final solve"):
            chained = {(e.i, e.j) for e in matched}
            kept = [e for e in edges if e.kind != "scan" or (e.j == e.i + 1 and (e.i, e.j) not in chained)]
            return self.graph.optimize_with(kept + matched)

    def _scan_poses(self, world_T_keyframe: FloatArray) -> FloatArray:
        local = np.array([step.local_T_body for step in self.steps])
        index = np.array([k.scan_index for k in self.keyframes], dtype=np.int64)
        return trajectory.spread_corrections(local, index, world_T_keyframe)

    def _twists(self, world_T_reference: FloatArray) -> FloatArray:
        """(S, 3) motion through every scan along a trajectory."""
        times = np.array(self._times_s)
        if len(times) < 2:
            return np.zeros((len(times), 3))
        offsets = np.array([(s.laser.offsets_s.min(), s.laser.offsets_s.max()) for s in self.scans])
        reference = np.array([reference_offset_s(s.laser) for s in self.scans])
        window_s = max(2.0 * float(np.median(np.diff(times))), 2.0 * self._odometry.backwards_s, 0.05)
        starts, ends = times + offsets[:, 0] - reference, times + offsets[:, 1] - reference
        return trajectory.twists_over(times, world_T_reference, starts, ends, window_s)

    def _solution(self, edges: list[Edge], localise: bool = False) -> Solution:
        world_T_reference = self._scan_poses(self.graph.poses())
        twists = self._twists(world_T_reference)
        if localise and len(self.keyframes) > 1:
            pairs = refine.neighbours(self.graph.poses(), self.config.refine)
            world_T_reference = refine.localise_between(
                self.scans, twists, world_T_reference, self.keyframes, pairs, self.config
            )
            twists = self._twists(world_T_reference)
        # a scan sensed before its stamp (transport delay) is carried on to it
        offsets = np.array([reference_offset_s(s.laser) for s in self.scans])
        reference_T_stamp = se2.exp(-offsets[:, None] * twists)
        keyframes = np.array([k.scan_index for k in self.keyframes], dtype=np.int64)
        return Solution(
            stamps_ns=np.array([s.stamp_ns for s in self.scans], dtype=np.int64),
            world_T_body=se2.compose(world_T_reference, reference_T_stamp),
            world_T_reference=world_T_reference,
            twists=twists,
            keyframes=keyframes,
            edges=edges_at_stamps(edges, reference_T_stamp[keyframes]) if offsets.any() else edges,
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
