"""Beyond the paper: one drive mapped in one way, and how far that is from the truth."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal, get_args

import numpy as np

from drivers.simulator import simulate, without_pose
from drivers.simulator.simulate import cast_scans
from mfslam import se2
from mfslam.config import Config, DeskewConfig, OdometryConfig
from mfslam.deskew import deskew, reference_offset_s
from mfslam.metrics import ate, crispness
from mfslam.odometry import OdometryTrack
from mfslam.settings import load, preset_path
from mfslam.slam import Slam, Solution
from mfslam.types import DeskewedScan, FloatArray, IntArray, Odometry
from paper import cases
from paper.beyond_conditions import Condition, laser, motion, place, robot

LOST_M, LOST_DEG = 0.1, 2.0  # a step of the front end from scan to scan that is farther off has failed
CELL_M = 0.05
MAX_SCANS = 60  # whose beams are compared with the truth one by one

DeskewMode = Literal["none", "range", "pose"]
MODES: tuple[DeskewMode, ...] = get_args(DeskewMode)

NO_SEARCH = ("frontend.search_window_m=0.001", "frontend.search_angle_deg=0.001")
NO_LOOPS = ("loops.use=false",)
NO_SECOND_PASS = ("refine.passes=0", "refine.localise=false")
NO_ODOMETRY = ("odometry.use=false",)
MEAN_TWIST = ("frontend.joint_twist=false",)  # of a scan: the mean motion since the one before


@dataclass(frozen=True)
class Method:
    """A way to map: presets over each other, then settings."""

    name: str
    presets: tuple[str, ...] = ()
    settings: tuple[str, ...] = ()

    @property
    def config(self) -> Config:
        return _config(self.presets, self.settings)


@lru_cache(maxsize=64)
def _config(presets: tuple[str, ...], given: tuple[str, ...]) -> Config:
    paths = [preset_path(name) for name in ("generic", *presets)]
    return load(paths, given)


CONVENTIONAL = Method(
    cases.CONVENTIONAL.name, cases.CONVENTIONAL.presets, (*cases.CONVENTIONAL.settings, *NO_SEARCH)
)
MOTION_FREE = Method(
    cases.MOTION_FREE.name, cases.MOTION_FREE.presets, (*cases.MOTION_FREE.settings, *NO_SEARCH)
)
ENGINE = Method("whole engine")
CONSTANT = Method("no wheels, constant twist", (), (*NO_ODOMETRY, *MEAN_TWIST))
JOINT = Method("no wheels, joint twist", (), NO_ODOMETRY)
WITHOUT_WHEELS = (CONSTANT, JOINT)
WITH_WHEELS = (CONVENTIONAL, MOTION_FREE, ENGINE)
FRONTIER = (*WITH_WHEELS, *WITHOUT_WHEELS)

# From the paper's registration to the whole engine, one stage after the other
LADDER = (
    CONVENTIONAL,
    MOTION_FREE,
    Method("+ wheels hold", MOTION_FREE.presets, (*cases.MOTION_FREE_HELD.settings, *NO_SEARCH)),
    Method("point to line", (), (*NO_SEARCH, *NO_LOOPS, *NO_SECOND_PASS)),
    Method("+ search", (), (*NO_LOOPS, *NO_SECOND_PASS)),
    Method("+ loops", (), NO_SECOND_PASS),
    ENGINE,
    *WITHOUT_WHEELS,
)


@dataclass
class Outcome:
    """Errors against the truth of the instants at which scans were really sensed.

    ``step_m``, ``step_deg``: RMS error of the front end's steps from scan to scan; ``worst_step_deg``: the
    largest; ``lost_share``: of those that failed. ``ate_m``, ``ate_deg``. ``blur``: 5 cm cells hit by the keyframes' points over those they truly hit.
    ``scan_error_m``: RMS displacement of a scan's points, compensated by the motion that is finally believed.
    ``searched_share``: scans placed by the correlative search. ``loops``: loop edges in the graph.
    """

    method: str
    step_m: float
    step_deg: float
    worst_step_deg: float
    lost_share: float
    ate_m: float
    ate_deg: float
    blur: float
    scan_error_m: float
    searched_share: float
    loops: int


@dataclass
class Measured:
    """A condition, the error (m, RMS) that compensation by the wheels' motion leaves in its scans, per mode of
    deskewing, and every method's outcome."""

    condition: Condition
    scan_error_m: dict[DeskewMode, float]
    outcomes: list[Outcome]

    def of(self, method: Method) -> Outcome:
        return next(o for o in self.outcomes if o.method == method.name)


class Truth:
    """One simulated drive with everything that is true of it.

    ``world_T_reference`` (S, 3): true poses where the scans' points stand once deskewed: at the reference
    instant that their laser tells, on the true clock. ``compared`` (N,): scans of a moving robot whose beams are
    compared one by one with where they truly hit.
    """

    def __init__(self, condition: Condition) -> None:
        self.condition = condition
        self.sensor, self.motion, world = laser(condition), motion(condition), place(condition)
        self.simulation = simulate(
            world, robot(condition), self.sensor, seed=condition.seed, motion=self.motion
        )
        self.messages = [without_pose(m) for m in self.simulation.messages]
        self.scans = self.simulation.scans
        told, instants_s = self.scans[0].laser, self.simulation.instants_s
        hidden_s = reference_offset_s(told) - float(told.offsets_s[0] - self.sensor.laser.offsets_s[0])
        self.world_T_reference = self.motion.at(instants_s + hidden_s)
        moving = np.flatnonzero(np.abs(self.motion.twist_at(instants_s + hidden_s)).max(axis=1) > 0.1)
        self.compared = moving[np.linspace(0, len(moving) - 1, min(MAX_SCANS, len(moving))).astype(np.int64)]
        self.exact_ranges_m = cast_scans(world, self.motion, self.sensor, instants_s[self.compared])

    def exact_points(self, n: int, ranges_m: FloatArray, beams: IntArray) -> FloatArray:
        """Points (M, 2) of beams (M,) of scan ``n``, each from the true pose at its instant, in the body frame at
        the reference instant."""
        spec = self.sensor.laser
        at_s = self.simulation.instants_s[n] + spec.offsets_s[beams]
        reference_T_laser = se2.compose(
            se2.between(self.world_T_reference[n], self.motion.at(at_s)), spec.body_T_laser
        )
        angle = reference_T_laser[:, 2] + spec.angles_rad[beams]
        reach = ranges_m[beams, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        return np.asarray(reference_T_laser[:, :2] + reach)

    def scan_error_m(self, twists: FloatArray, mode: DeskewMode) -> float:
        """RMS displacement of the points that compensation by ``twists`` (S, 3) leaves; no noise of ranges in it."""
        squares = []
        for n, ranges_m in zip(self.compared, self.exact_ranges_m, strict=True):
            exact = replace(self.scans[n], ranges_m=ranges_m.astype(np.float32))
            cloud = deskew(exact, twists[n], DeskewConfig(mode=mode))
            off = cloud.points_m - self.exact_points(n, ranges_m, cloud.beams)
            squares.append(np.sum(off**2, axis=1))
        return float(np.sqrt(np.mean(np.concatenate(squares))))

    def wheel_twists(self) -> FloatArray:
        """(S, 3) motion through each scan as the wheels tell it, at the times that the stamps tell."""
        odometry, start_ns = OdometryConfig(), self.simulation.start_ns
        track = OdometryTrack(odometry)
        for message in self.simulation.messages:
            if isinstance(message, Odometry):
                track.add((message.stamp_ns - start_ns) * 1e-9, message.odom_T_body)
        offsets_s = self.scans[0].laser.offsets_s
        stamps_s = [(scan.stamp_ns - start_ns) * 1e-9 for scan in self.scans]
        first, last = float(offsets_s.min()), float(offsets_s.max())
        return np.array([track.twist_over(t + first, t + last, odometry) for t in stamps_s])

    def blur(self, solution: Solution, clouds: Iterable[DeskewedScan]) -> float:
        """5 cm cells hit by the keyframes' points where the method puts them, over those that they truly hit."""
        estimated, true = [], []
        for n, cloud in zip(solution.keyframes, clouds, strict=True):
            estimated.append(se2.transform(solution.world_T_reference[n], cloud.points_m))
            exact = self.exact_points(n, self.scans[n].ranges_m.astype(np.float64), cloud.beams)
            true.append(se2.transform(self.world_T_reference[n], exact))
        cells = [crispness(np.concatenate(points), CELL_M).cells for points in (estimated, true)]
        return cells[0] / cells[1]


def drive_for(condition: Condition, method: Method) -> Condition:
    """The drive that a method's map depends on: without wheels none of their faults does anything to it, nor
    does a delay between clocks that nobody knows of."""
    if method not in WITHOUT_WHEELS:
        return condition
    return replace(
        condition,
        delay_s=condition.delay_s if condition.delay_known else 0.0,
        ticks_per_turn=Condition.ticks_per_turn,
        slip_m_per_sqrt_m=Condition.slip_m_per_sqrt_m,
        radius_error=Condition.radius_error,
        track_error=Condition.track_error,
    )


def measure(condition: Condition, methods: Iterable[Method]) -> Measured:
    """Simulate one drive and map it in every way."""
    truth = Truth(condition)
    wheels = truth.wheel_twists()
    left = {mode: truth.scan_error_m(wheels, mode) for mode in MODES}
    return Measured(condition, left, [run(truth, method) for method in methods])


def run(truth: Truth, method: Method) -> Outcome:
    """Map a drive and compare with the truth."""
    slam = Slam(method.config)
    for message in truth.messages:
        slam.feed(message)
    solution = slam.finish()
    true = truth.world_T_reference
    local = np.array([step.local_T_body for step in slam.steps])
    off = se2.between(se2.between(true[:-1], true[1:]), se2.between(local[:-1], local[1:]))
    step_m, step_deg = np.hypot(off[:, 0], off[:, 1]), np.degrees(np.abs(off[:, 2]))
    absolute = ate(true, solution.world_T_reference)
    mode = method.config.deskew.mode
    return Outcome(
        method=method.name,
        step_m=float(np.sqrt(np.mean(step_m**2))),
        step_deg=float(np.sqrt(np.mean(step_deg**2))),
        worst_step_deg=float(step_deg.max()),
        lost_share=float(np.mean((step_m > LOST_M) | (step_deg > LOST_DEG))),
        ate_m=absolute.translation_m.rmse,
        ate_deg=absolute.rotation_deg.rmse,
        blur=truth.blur(solution, [keyframe.cloud for keyframe in slam.keyframes]),
        scan_error_m=truth.scan_error_m(solution.twists, mode),
        searched_share=float(np.mean([step.searched for step in slam.steps])),
        loops=sum(edge.kind == "loop" for edge in solution.edges),
    )
