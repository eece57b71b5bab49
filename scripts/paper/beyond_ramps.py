"""Beyond the paper: the twist through each scan while a robot without wheels begins and ends to turn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from mfslam import se2
from mfslam.deskew import STILL
from mfslam.frontend import Frontend
from mfslam.step_records import PredictedMotion
from mfslam.types import FloatArray, Match, Scan
from paper.beyond_conditions import RAMP_S, Condition
from paper.beyond_figures import Staircase
from paper.beyond_pages import Results, in_cm, outcome, table
from paper.beyond_runs import ENGINE, WITHOUT_WHEELS, Method, Truth

DRAWN_S = 7.0  # of each drive: a turn to the left and one to the right


@dataclass(eq=False)
class WatchedFrontend(Frontend):
    """A front end that keeps the twist (3,) that it compensates each scan by, from the second one on."""

    twists: list[FloatArray] = field(default_factory=list)

    def _motion_within(
        self,
        scan: Scan,
        match: Match,
        onward: FloatArray,
        step: FloatArray,
        motion: PredictedMotion,
        searched: bool,
    ) -> tuple[FloatArray, FloatArray]:
        twist, guess = super()._motion_within(scan, match, onward, step, motion, searched)
        self.twists.append(twist)
        return twist, guess


@dataclass(frozen=True, eq=False)
class Trace:
    """Yaw rates (rad/s) through a drive. ``moments_s``, ``true_rad_s``: at every moment; ``starts_s`` (S,),
    ``scan_s``: when scans begin and how long they take; ``mean_rad_s`` (S,): the true mean through each scan;
    ``found_rad_s`` (S,), ``scan_error_m``: by method, what is believed of each and what compensation by it leaves."""

    condition: Condition
    moments_s: FloatArray
    true_rad_s: FloatArray
    starts_s: FloatArray
    scan_s: float
    mean_rad_s: FloatArray
    found_rad_s: Mapping[str, FloatArray]
    scan_error_m: Mapping[str, float]

    def figures(self) -> dict[str, Any]:
        """What is kept of it as numbers."""
        found = {name: rates.tolist() for name, rates in self.found_rad_s.items()}
        return {
            "condition": asdict(self.condition),
            "starts_s": self.starts_s.tolist(),
            "mean_rad_s": self.mean_rad_s.tolist(),
            "found_rad_s": found,
            "scan_error_m": dict(self.scan_error_m),
        }

    def rms_rad_s(self, method: Method) -> float:
        """Error of the yaw rate that a method believes of a scan."""
        return float(np.sqrt(np.mean((self.found_rad_s[method.name] - self.mean_rad_s) ** 2)))


def trace(condition: Condition) -> Trace:
    """What the front end believes of the motion within scans, without wheels; in both ways."""
    truth = Truth(condition)
    first, last = float(truth.scans[0].laser.offsets_s.min()), float(truth.scans[0].laser.offsets_s.max())
    starts_s = truth.simulation.instants_s[1:] + first
    turned = se2.between(truth.motion.at(starts_s), truth.motion.at(starts_s + last - first))[:, 2]
    twists = {method.name: twists_within(truth.scans, method) for method in WITHOUT_WHEELS}
    moments_s = np.arange(0.0, truth.motion.duration_s, 0.01)
    return Trace(
        condition=condition,
        moments_s=moments_s,
        true_rad_s=truth.motion.twist_at(moments_s)[:, 2],
        starts_s=starts_s,
        scan_s=last - first,
        mean_rad_s=turned / (last - first),
        found_rad_s={name: found[1:, 2] for name, found in twists.items()},
        scan_error_m={name: truth.scan_error_m(found, "pose") for name, found in twists.items()},
    )


def twists_within(scans: Sequence[Scan], method: Method) -> FloatArray:
    """(S, 3) as the front end believes them when nobody tells it of the motion; still in the first scan."""
    return np.array([STILL, *watched_frontend(scans, method).twists])


def watched_frontend(scans: Sequence[Scan], method: Method) -> WatchedFrontend:
    """A front end that has placed all scans as that of the engine does without wheels."""
    frontend = WatchedFrontend(method.config)
    before_ns = scans[0].stamp_ns
    for n, scan in enumerate(scans):
        dt_s = (scan.stamp_ns - before_ns) * 1e-9
        mean = se2.log(frontend.last_step) / dt_s if n else STILL
        frontend.process(n, scan, PredictedMotion(mean, dt_s))
        before_ns = scan.stamp_ns
    return frontend


def name_of(condition: Condition) -> str:
    return f"0 to {condition.yaw_rate_rad_s:g} rad/s in {RAMP_S:g} s, {condition.rate_hz:g} Hz"


def staircases(traces: Sequence[Trace]) -> list[Staircase]:
    """The beginning of every drive, as it is drawn."""
    return [
        Staircase(
            name_of(t.condition),
            *(t.moments_s, t.true_rad_s, t.starts_s, t.scan_s, dict(t.found_rad_s), DRAWN_S),
        )
        for t in traces
    ]


def ramps_table(results: Results, traces: Sequence[Trace]) -> str:
    """Every drive in every way: the twist, the steps and the scans of the front end, and what is left at the end."""
    rows = []
    for t in traces:
        for method in (*WITHOUT_WHEELS, ENGINE):
            o = outcome(results, t.condition, method)
            watched = method in WITHOUT_WHEELS
            yaw_rate = f"{t.rms_rad_s(method):.2f}" if watched else ""
            scan = in_cm(t.scan_error_m[method.name]) if watched else ""
            rows.append(
                [
                    *(name_of(t.condition), method.name, yaw_rate, f"{o.worst_step_deg:.1f}", scan),
                    *(in_cm(o.scan_error_m), in_cm(o.ate_m), f"{o.ate_deg:.2f}"),
                ]
            )
    head = ["turns", "method", "yaw rate off (RMS), rad/s", "worst step, deg", "left in a scan, cm", "at the end, cm", "ATE cm", "ATE deg"]  # fmt: skip
    return table(head, rows)
