"""What wheels, gyro and compass tell: the motion before a scan is matched, and edges between keyframes."""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache

import numpy as np

from mfslam import se2
from mfslam.config import Config
from mfslam.deskew import reference_offset_s
from mfslam.heading import HeadingTrack
from mfslam.kernels import poses
from mfslam.kinematics import WheelIntegrator
from mfslam.odometry import OdometryTrack, begins_anew, is_jump
from mfslam.stamps import ScanPace, StampClock, SteadyPace
from mfslam.step_records import PredictedMotion
from mfslam.types import (
    Edge,
    Findings,
    FloatArray,
    Imu,
    Laser,
    Message,
    Odometry,
    Scan,
    WheelAngles,
    WheelTicks,
)
from mfslam.wheel_errors import WheelErrors, WheelStep

STARTED_M, STARTED_RAD = 0.5, 0.3  # wheels that still show nothing by then are not connected
JITTER, TOLD_JITTER_S = "stamp-jitter", 0.003  # the finding, and what is worth it
COUNTER_JUMP = "wheel-counter-jump"  # the finding of a step that was left out
UNKNOWN_STEP = np.full(3, np.nan)
LAG_S = 0.5  # odometry older than this says nothing of a scan


class MotionSources:
    """Every source of motion but the scans themselves, on one clock.

    ``times_s``: reference instant of every scan, held where stamps go backwards a little, going on from
    before where the clock jumps. ``jumps``: scans whose wheel motion was found wrong, here or by the scans.
    """

    def __init__(self, config: Config, findings: Findings) -> None:
        self.config = config
        self.findings = findings
        self.odometry = OdometryTrack(config.odometry)
        self.heading = HeadingTrack(config.imu)
        self.times_s: list[float] = []
        self.jumps: list[int] = []
        self.wheel_errors = WheelErrors(config.odometry)
        self._wheels = WheelIntegrator(config.wheels, findings)
        self._wheel_steps: dict[tuple[int, int], WheelStep] = {}  # between keyframes
        self._told_T_body: FloatArray | None = None  # the wheels' latest pose, as told
        self.counts_wheels = False  # ticks or angles, not poses, tell of the wheels
        # of every knot of the track, with the wheels' step to it as told (3 each), NaN where it is not known
        self.told_times_s, self.told_steps = array("d"), array("d")
        self.told_with_scans: list[
            FloatArray | None
        ] = []  # the wheels' pose that came with each scan, as told
        self._streamed = False  # whether that pose came in a message of its own
        self._with_scan: FloatArray | None = None  # corrected pose that came with the latest scan
        self._odom_T_body: list[FloatArray | None] = []  # at every scan
        self._clock = StampClock(findings)
        self._bursts, self._pace = ScanPace(), SteadyPace()
        self._scan_s = self._scan_pause_s = 0.0  # the latest scan's time, and the pause before it
        self._next_gap_s: float | None = None  # from its stamp to that of the scan after it

    def expect(self, following: Scan, waiting: Scan) -> None:
        """The scan after the one that is about to be placed: stamps close together tell of a burst."""
        self._next_gap_s = (following.stamp_ns - waiting.stamp_ns) * 1e-9

    def add(self, message: Message) -> None:
        """Take note of a message of any kind."""
        time_s, clock_jump_s = self._clock.place(message)
        pause_s = max(0.0, clock_jump_s)  # by the stamps alone, a clock set ahead is a log that pauses
        if isinstance(message, Scan):
            self._scan_s, self._scan_pause_s, self._next_gap_s = time_s, pause_s, None
            told = message.odom_T_body
            self.told_with_scans.append(told)
            self._with_scan = None if told is None else self._add_odometry(time_s, told, pause_s, True)
        elif isinstance(message, Odometry):
            self._add_odometry(time_s, message.odom_T_body, pause_s)
        elif isinstance(message, (WheelTicks, WheelAngles)):
            self._add_wheels(time_s, message, pause_s)
        elif isinstance(message, Imu):
            self.heading.add(time_s, message, after_gap=clock_jump_s != 0.0)

    def _add_wheels(self, time_s: float, message: WheelTicks | WheelAngles, pause_s: float) -> None:
        self.counts_wheels = True
        left_out = self.findings.count(COUNTER_JUMP)
        placed = replace(message, stamp_ns=self._clock.on_time_line(message))
        told = (
            self._wheels.add_ticks(placed)
            if isinstance(placed, WheelTicks)
            else self._wheels.add_angles(placed)
        )
        self._add_odometry(
            time_s, told.odom_T_body, pause_s, broken=self.findings.count(COUNTER_JUMP) > left_out
        )

    def _add_odometry(
        self,
        time_s: float,
        odom_T_body: FloatArray,
        pause_s: float,
        from_scan: bool = False,
        broken: bool = False,
    ) -> FloatArray:
        """The track goes on by the wheels' step, less the errors that are known of them.

        A pose that a scan brings from before what a stream of its own has told since stays out of the track:
        the wheels would seem to jump back and forth. ``broken``: a step is missing before this pose.
        """
        track = self.odometry
        corrected = odom_T_body
        step = UNKNOWN_STEP
        if self._told_T_body is not None:
            if begins_anew(self._told_T_body, odom_T_body):
                self.findings.add(
                    "odometry-restart",
                    "the wheels' pose begins again at its origin: that step was left to the scans",
                    f"{time_s:.3f} s from the start",
                )
                corrected, broken = track.odom_T_body[-1].copy(), True
            else:
                step = poses.between(self._told_T_body, odom_T_body)
                corrected = self.wheel_errors.advanced(track.odom_T_body[-1], step)
        if from_scan and self._streamed and time_s < track.last_s:
            return corrected
        self._streamed = not from_scan
        self._told_T_body = odom_T_body
        track.add(time_s, corrected, pause_s, broken)
        self.told_times_s.append(track.last_s)
        self.told_steps.extend(UNKNOWN_STEP if broken else step.tolist())
        return corrected

    def predict(self, scan: Scan, local_T_body: FloatArray, last_step: FloatArray) -> PredictedMotion:
        """Motion since the previous scan and through this one, where wheels and gyro tell.

        ``local_T_body`` (3,), ``last_step`` (3,): where the front end stands, and how it got there.
        """
        laser, config = scan.laser, self.config
        stamp_s = self._sensed_s(scan)
        reference_s = stamp_s + reference_offset_s(laser)
        first_s, last_s = _span_s(laser)
        start_s, end_s = stamp_s + first_s, stamp_s + last_s
        time_s = max(reference_s, self.times_s[-1]) if self.times_s else reference_s
        dt_s = time_s - self.times_s[-1] if self.times_s else 0.0
        odom = self._odometry_at(scan, reference_s, local_T_body) if config.odometry.use else None
        previous = self._odom_T_body[-1] if self._odom_T_body else None
        turn_rad = self.heading.turn(self.times_s[-1], time_s) if self.times_s else None
        self.times_s.append(time_s)
        self._odom_T_body.append(odom)
        step = None
        if odom is not None and previous is not None:
            step = poses.between(previous, odom)
            if is_jump(step, dt_s + self._scan_pause_s, config.odometry) or self.odometry.is_broken(
                time_s - dt_s, time_s
            ):
                self.findings.add(
                    "odometry-jump",
                    "the wheels' pose jumps farther than a robot drives: that step was left to the scans",
                    f"{scan.stamp_ns * 1e-9:.6f} s",
                )
                self.jumps.append(len(self.times_s) - 1)
                step = None
        if step is not None:
            twist = self.odometry.twist_over(start_s, end_s, config.odometry)
        elif dt_s > 0.0:
            twist = poses.log(last_step) / max(dt_s, 0.02)
        else:
            twist = np.zeros(3)
        if turn_rad is not None and dt_s > 0.0:
            twist = np.array([twist[0], twist[1], turn_rad / dt_s])
        return PredictedMotion(twist, dt_s, step, turn_rad, self.wheel_errors.noise_scale, self._scan_pause_s)

    def settle_times(self) -> None:
        """At the end of a log, the instants of scans of a laser that turns steadily by the stamps after them, too."""
        later_s = self._pace.settle()
        if len(later_s) == len(self.times_s):
            settled_s = np.array(self.times_s) + (1.0 - self.config.sensor.clock_drift) * later_s
            self.times_s = np.maximum.accumulate(settled_s).tolist()

    @property
    def comes_with_scans(self) -> bool:
        """Whether each scan of the log bears the wheels' pose: put together by the recorder, by its own clock."""
        return bool(self.told_with_scans) and self.told_with_scans[0] is not None

    def has_wheels(self, a: int, b: int) -> bool:
        """Whether the wheels told where both scans stand."""
        return self._odom_T_body[a] is not None and self._odom_T_body[b] is not None

    def edges(
        self, i: int, j: int, a: int, b: int, matched: FloatArray, information: FloatArray, sure: bool
    ) -> Iterator[Edge]:
        """Wheel and heading edges from keyframe ``i`` (scan ``a``) to ``j`` (scan ``b``).

        ``matched`` (3,), ``information`` (3, 3): what the scans say of that step; ``sure``: they fit well.
        """
        odom_a, odom_b = self._odom_T_body[a], self._odom_T_body[b]
        t0, t1 = self.times_s[a], self.times_s[b]
        learned = False
        if odom_a is not None and odom_b is not None:
            wheels = poses.between(odom_a, odom_b)
            jumped = bool(self.jumps) and self.jumps[-1] > a
            # a step that nothing can drive stays out: at 1e9 m the least information still pulls
            if not (jumped and is_jump(wheels, t1 - t0, self.config.odometry)):
                step = WheelStep(self.wheel_errors.told(wheels), matched, information, jumped)
                self._wheel_steps[i, j] = step
                yield from self._wheel_edges([(i, j)])
                learned = sure and not jumped
                if learned:
                    self.wheel_errors.learn(step)
        if not learned:
            self.wheel_errors.skip()
        turn_rad = self.heading.turn(t0, t1)
        if turn_rad is not None:
            yield _heading_edge(i, j, turn_rad, self.heading.turn_sigma(t1 - t0))
            self.heading.learn_bias(t1 - t0, turn_rad, float(matched[2]))
        compass = self.heading.compass(t1)
        if compass is not None:
            yield _heading_edge(j, j, *compass)

    @property
    def wheel_steps(self) -> list[tuple[int, int, WheelStep]]:
        """What the wheels told between keyframes i and j."""
        return [(i, j, step) for (i, j), step in self._wheel_steps.items()]

    def revised(self, edges: list[Edge]) -> list[Edge]:
        """The edges, those of wheels by all that was learned of their errors until now."""
        out = list(edges)
        rows = [n for n, e in enumerate(edges) if e.kind == "odometry" and (e.i, e.j) in self._wheel_steps]
        for n, edge in zip(rows, self._wheel_edges([(edges[n].i, edges[n].j) for n in rows]), strict=True):
            out[n] = edge
        return out

    def _wheel_edges(self, ends: list[tuple[int, int]]) -> list[Edge]:
        """Of the steps that the wheels told between these keyframes."""
        if not ends:
            return []
        factors = self.wheel_errors.factors([self._wheel_steps[pair] for pair in ends])
        return [Edge("odometry", *pair, *factor) for pair, *factor in zip(ends, *factors, strict=True)]

    def _sensed_s(self, scan: Scan) -> float:
        """When the scan was sensed, by its stamp; poses that came with scans are as late as they are."""
        if scan.odom_T_body is not None:
            return self._scan_s
        sensed_s = self._bursts.sensed_s(self._scan_s, self._next_gap_s)
        if sensed_s < self._scan_s:
            self.findings.add(
                "stamp-burst",
                "scans come in bursts, stamped on arrival: those before the last of a burst were taken to be "
                "sensed one usual step apart",
                f"{scan.stamp_ns * 1e-9:.6f} s, {self._scan_s - sensed_s:.3f} s late",
            )
        sensed_s = self._pace.sensed_s(sensed_s)
        if self._pace.jitter_s > TOLD_JITTER_S and not self.findings.count(JITTER):
            self.findings.add(
                JITTER,
                f"stamps of scans scatter by {1e3 * self._pace.jitter_s:.0f} ms about the steady turn of the laser: each was "
                "taken to be sensed in its turn",
                f"{scan.stamp_ns * 1e-9:.6f} s",
            )
        return sensed_s - self.config.sensor.clock_drift * sensed_s

    def _odometry_at(self, scan: Scan, reference_s: float, local_T_body: FloatArray) -> FloatArray | None:
        """Wheels' pose at the scan's reference instant; None where they say nothing (yet)."""
        track = self.odometry
        if not track.has_moved and (len(track) == 0 or _has_left_start(local_T_body)):
            return None  # no wheels, or none that turn: a pose that never changes is no measurement
        if self._with_scan is not None:
            offset_s = reference_offset_s(scan.laser)
            if offset_s == 0.0:
                return self._with_scan
            twist = track.twist_over(self._scan_s, self._scan_s, self.config.odometry)
            return se2.compose(self._with_scan, se2.exp(twist * offset_s))
        if not track.first_s - LAG_S <= reference_s <= track.last_s + LAG_S:
            self.findings.add(
                "odometry-gap",
                "no odometry around a scan: it was placed without wheels",
                f"{scan.stamp_ns * 1e-9:.6f} s",
            )
            return None
        since_s = reference_s - track.last_s
        if since_s <= 0.0:
            return track.pose_at(reference_s)
        # the wheels have not told this instant yet: they turn on as they did, and do not stand still
        twist = track.twist_over(track.last_s, track.last_s, self.config.odometry)
        return se2.compose(track.odom_T_body[-1], se2.exp(twist * since_s))


@lru_cache(maxsize=64)
def _span_s(laser: Laser) -> tuple[float, float]:
    """Instants of a scan's first and last beam, from its stamp."""
    return float(laser.offsets_s.min()), float(laser.offsets_s.max())


def _has_left_start(local_T_body: FloatArray) -> bool:
    """Whether the scans tell of a robot that drives, whatever its wheels say."""
    x, y, theta = local_T_body
    return math.hypot(x, y) > STARTED_M or abs(theta) > STARTED_RAD


def _heading_edge(i: int, j: int, turn_rad: float, sigma_rad: float) -> Edge:
    return Edge("heading", i, j, np.array([0.0, 0.0, turn_rad]), np.diag([0.0, 0.0, sigma_rad**-2]))
