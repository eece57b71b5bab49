"""Beyond the paper: where motion-free ICP stops working, and what takes over."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path

from paper import beyond_pages as pages
from paper.beyond_claims import claims
from paper.beyond_conditions import ACCELERATION_M_S2, LATERAL_M_S2, YAW_ACCELERATION_RAD_S2
from paper.beyond_figures import draw_frontier, draw_panels, draw_staircases
from paper.beyond_logs import (
    CONSTANT_TWIST,
    JOINT_TWIST,
    SNAPSHOTS,
    WHEELS,
    LogOutcome,
    logs_at_hand,
    map_log,
)
from paper.beyond_pages import Results
from paper.beyond_plan import BASE, QUICK, Plan
from paper.beyond_ramps import Trace, ramps_table, staircases, trace
from paper.beyond_runs import (
    ENGINE,
    JOINT,
    LOST_DEG,
    LOST_M,
    MEAN_TWIST,
    MOTION_FREE,
    NO_ODOMETRY,
    Measured,
    measure,
)
from paper.section import Effort, Section

FRONTIER_PNG, FAULT_FRONTIER_PNG = "beyond-frontier.png", "beyond-fault-frontier.png"
SCANS_PNG, FAULTS_PNG, RAMPS_PNG = "beyond-scans.png", "beyond-faults.png", "beyond-ramps.png"
LOG_VARIANTS: dict[str, tuple[str, ...]] = {
    WHEELS: (),
    JOINT_TWIST: NO_ODOMETRY,
    CONSTANT_TWIST: (*NO_ODOMETRY, *MEAN_TWIST),
    SNAPSHOTS: (*NO_ODOMETRY, "deskew.mode=none"),
}


@dataclass(frozen=True)
class Ran:
    """All that was run: drives in all ways, recorded logs, and the twists through the ramps."""

    results: Results
    logs: list[LogOutcome]
    traces: list[Trace]


def run(effort: Effort) -> Section:
    """All drives and logs, mapped in all ways."""
    plan = QUICK if effort.quick else Plan()
    ran = run_all(plan, effort.jobs)
    if effort.figures is not None:
        draw(effort.figures, ran, plan)
    return Section(
        title="Beyond it: where motion-free ICP stops working, and what takes over",
        body=body(ran, plan),
        claims=claims(ran.results, ran.logs, plan),
        measured={
            "drives": [asdict(m) for m in ran.results.values()],
            "logs": [asdict(o) for o in ran.logs],
            "ramps": [t.figures() for t in ran.traces],
        },
    )


def run_all(plan: Plan, jobs: int) -> Ran:
    """Every drive and every log at hand, in ``jobs`` processes."""
    drives = plan.drives()
    with ProcessPoolExecutor(jobs) as pool:
        logs = [
            pool.submit(map_log, path, variant, settings, plan.max_scans)
            for path in logs_at_hand()[: plan.max_logs]
            for variant, settings in LOG_VARIANTS.items()
        ]
        measured = pool.map(measure, drives.keys(), drives.values())
        traces = pool.map(trace, plan.ramps())
        results = dict(zip(drives, measured, strict=True))
        return Ran(results, [log.result() for log in logs], list(traces))


def draw(folder: Path, ran: Ran, plan: Plan) -> None:
    results = ran.results
    draw_frontier(folder / FRONTIER_PNG, pages.frontier_rows(results, plan))
    draw_frontier(folder / FAULT_FRONTIER_PNG, pages.fault_rows(results, plan))
    draw_panels(folder / SCANS_PNG, [pages.scan_panels(results, plan)], 3.3)
    draw_panels(folder / FAULTS_PNG, pages.fault_panels(results, plan), 4.6)
    draw_staircases(folder / RAMPS_PNG, staircases(ran.traces))


def body(ran: Ran, plan: Plan) -> str:
    """The section in markdown."""
    results = ran.results
    snapshot, ranged = (results[plan.base].scan_error_m[mode] for mode in ("none", "range"))
    return f"""A hall of 46 m by 24 m, a robot that can do it ({ACCELERATION_M_S2:g} m/s2 forward, {LATERAL_M_S2:g} m/s2 in
bends, {YAW_ACCELERATION_RAD_S2:g} rad/s2), a laser of 360 deg and 20 m with 2 cm of noise whose scans take the whole turn. Two drives: a
lap of the hall, and turns in place on a straight way. One factor is changed at a time; else wheels
are {100 * BASE.radius_error:g} % wrong in radius and track, read to 1/{BASE.ticks_per_turn} turn, slipping {1000 * BASE.slip_m_per_sqrt_m:g} mm per root m. Errors are those
of the body at the instants when scans were really sensed, so a delay is no error by itself. Every drive is
made once, with one seed: single cells near the border may fall on either side.

- *conventional*, *motion-free ICP*: the paper's two, alone: the wheels start a match and hold nothing; no search, no loops, no
  second pass;
- *whole engine*: default settings;
- *no wheels*: the same with `odometry.use=false`. *Joint twist*, the default: the motion through a scan is estimated
  together with its pose, from the distortion that it left in the scan. *Constant twist* (`frontend.joint_twist=false`): it
  is taken to be the mean motion since the scan before;
- of use: ATE up to {pages.USABLE_M:g} m and {pages.USABLE_DEG:g} deg. A step of the front end has failed when it is off by more than
  {LOST_M:g} m or {LOST_DEG:g} deg. Blur: 5 cm cells that the keyframes' points hit, over those that they truly hit.

### Where it stops

![ATE over motion and sensor rate]({FRONTIER_PNG})

![ATE over motion and what is wrong with wheels and clocks]({FAULT_FRONTIER_PNG})

ATE in cm; the line is the border of what is of use. No slip and no unknown delay of the wheels changes a map made without
them. Up to where every drive is of use:

{pages.reach_table(pages.frontier_rows(results, plan))}

{pages.reach_table(pages.fault_rows(results, plan))}

### What takes over

The same drives with one more stage from left to right: ATE in cm (failed steps of the front end), of use in bold.

{pages.ladder_table(results, plan)}

<details><summary>Every figure of these drives</summary>

{pages.detail_table(results, plan)}

</details>

### What is left of the scans' own error

![Error left in a scan]({SCANS_PNG})

The displacement of a scan's points against where they truly hit, seen from the stamp: without noise, so it is all
systematic. At 3 m/s a snapshot is wrong by {pages.in_cm(snapshot)} cm, the paper's range variant by {pages.in_cm(ranged)} cm: one
number along the beam is right ahead of the robot, has the wrong sign behind it, and knows nothing of turns.

### Delays and encoders

![ATE and blur over faults]({FAULTS_PNG})

{faults_body(results, plan)}

### Odometry taken away

{ramps_body(ran)}

{logs_body(ran.logs)}
"""


def ramps_body(ran: Ran) -> str:
    return f"""A robot without wheels that begins to turn, in an office: from rest to its full rate, and back, within a few scans.

![Yaw rate through ramps, true and as believed]({RAMPS_PNG})

A bar is what the front end believes of one scan, as long as that scan took. A constant twist is that of the step before: late
by as much as the robot turned faster meanwhile, which bends the scan, which spoils the next match.

{ramps_table(ran.results, ran.traces)}

*Left in a scan*: displacement of its points as above, compensated by the front end's twist; *at the end*: by the motion of the
final trajectory, a mean over about two scans."""


def faults_body(results: Results, plan: Plan) -> str:
    """What the picture of faults shows, in numbers."""
    slip = results[plan.slipping()[-1]]
    small = results[plan.too_small()[-1]]
    coarse = results[plan.quantised()[-1]]
    free = pages.outcome(results, plan.base, JOINT)

    def pair(measured: Measured) -> str:
        alone, engine = measured.of(MOTION_FREE), measured.of(ENGINE)
        return f"{pages.in_cm(alone.ate_m)} cm alone, {pages.in_cm(engine.ate_m)} cm in the whole engine"

    return f"""With radii {100 * plan.wheel_errors[-1]:g} % too small ATE is {pair(small)}; with {plan.pulses[-1]} pulses per
turn {pair(coarse)}. Where wheels slip by {100 * plan.slips[-1]:g} cm per root m, compensating by them
leaves {pages.in_cm(slip.scan_error_m["pose"])} cm in a scan, a snapshot {pages.in_cm(slip.scan_error_m["none"])} cm: {pair(slip)},
and {pages.in_cm(free.ate_m)} cm when the engine is not given the wheels at all. No fault of the wheels changes a map made
without them: its curves are one run, drawn for comparison (but for the known delay, where the poses stand for
other instants)."""


def logs_body(logs: list[LogOutcome]) -> str:
    if not logs:
        return "Recorded logs with their odometry taken away: none at hand, left out."
    return f"""Recorded logs, default settings of their sensors; `odometry.use=false` takes the wheels away. Relations: mean errors
against hand-verified ones. Cells and entropy are those of all hits: fewer and lower is crisper, and where there are no
relations they are all there is to judge by.

{pages.logs_table(logs)}"""
