"""Beyond the paper: where motion-free ICP stops working, and what takes over."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from pathlib import Path

from paper import beyond_pages as pages
from paper.beyond_conditions import ACCELERATION_M_S2, LATERAL_M_S2, YAW_ACCELERATION_RAD_S2, Condition
from paper.beyond_figures import draw_frontier, draw_panels
from paper.beyond_logs import LogOutcome, logs_at_hand, map_log
from paper.beyond_plan import BASE, QUICK, Plan
from paper.beyond_runs import (
    CONVENTIONAL,
    ENGINE,
    LOST_DEG,
    LOST_M,
    MOTION_FREE,
    NO_ODOMETRY,
    NO_WHEELS,
    Measured,
    Method,
    measure,
)  # fmt: skip
from paper.section import Claim, Effort, Section

FRONTIER_PNG, FAULT_FRONTIER_PNG = "beyond-frontier.png", "beyond-fault-frontier.png"
SCANS_PNG, FAULTS_PNG = "beyond-scans.png", "beyond-faults.png"
LOG_VARIANTS: dict[str, tuple[str, ...]] = {
    "wheels": (),
    "no wheels, snapshots": (*NO_ODOMETRY, "deskew.mode=none"),
    "no wheels, twist of the match": NO_ODOMETRY,
}

Results = dict[Condition, Measured]


def run(effort: Effort) -> Section:
    """All drives and logs, mapped in all ways."""
    plan = QUICK if effort.quick else Plan()
    results, logs = run_all(plan, effort.jobs)
    if effort.figures is not None:
        draw(effort.figures, results, plan)
    return Section(
        title="Beyond it: where motion-free ICP stops working, and what takes over",
        body=body(results, logs, plan),
        claims=claims(results, plan),
        measured={"drives": [asdict(m) for m in results.values()], "logs": [asdict(o) for o in logs]},
    )


def run_all(plan: Plan, jobs: int) -> tuple[Results, list[LogOutcome]]:
    """Every drive and every log at hand, in ``jobs`` processes."""
    drives = plan.drives()
    with ProcessPoolExecutor(jobs) as pool:
        logs = [
            pool.submit(map_log, path, variant, settings, plan.max_scans)
            for path in logs_at_hand()[: plan.max_logs]
            for variant, settings in LOG_VARIANTS.items()
        ]
        measured = list(pool.map(measure, drives.keys(), drives.values()))
        return dict(zip(drives, measured, strict=True)), [log.result() for log in logs]


def draw(folder: Path, results: Results, plan: Plan) -> None:
    draw_frontier(folder / FRONTIER_PNG, pages.frontier_rows(results, plan))
    draw_frontier(folder / FAULT_FRONTIER_PNG, pages.fault_rows(results, plan))
    draw_panels(folder / SCANS_PNG, [pages.scan_panels(results, plan)], 3.3)
    draw_panels(folder / FAULTS_PNG, pages.fault_panels(results, plan), 4.6)


def claims(results: Results, plan: Plan) -> list[Claim]:
    """What this section says in the page's table of claims."""
    grid = plan.grid()
    usable = {
        m.name: {c for c in grid if pages.is_usable(pages.outcome(results, c, m))}
        for m in (CONVENTIONAL, MOTION_FREE, ENGINE, NO_WHEELS)
    }

    healthy = [c for c in grid if c in {d for row in (*plan.laps(), *plan.spins()) for d in row}]
    spoilt = [c for c in grid if c not in healthy]

    def share(method: Method, among: list[Condition]) -> str:
        return f"{len(usable[method.name] & set(among))} of {len(among)}"

    def lost(method: Method, among: list[Condition]) -> str:
        return pages.named([c for c in among if c not in usable[method.name]])

    latest = plan.late(False)[-1]
    told, first = results[plan.late(True)[-1]].of(ENGINE), results[plan.late(False)[0]].of(ENGINE)
    late = results[latest].of(ENGINE)
    return [
        Claim(
            "Motion-free ICP is free of the robot's motion: also at up to 6 m/s and 4 rad/s, 5 to 40 Hz, with wheels "
            f"{100 * BASE.radius_error:g} % wrong",
            f"of use in {share(MOTION_FREE, healthy)} drives; conventional ICP in {share(CONVENTIONAL, healthy)}",
            set(healthy) <= usable[MOTION_FREE.name],
            f"not of use: {lost(MOTION_FREE, healthy)}",
        ),
        Claim(
            "It is so with any wheels and clocks: also where wheels slip and stamps are late, unknown to it",
            f"of use in {share(MOTION_FREE, spoilt)} drives; conventional ICP in {share(CONVENTIONAL, spoilt)}",
            set(spoilt) <= usable[MOTION_FREE.name],
            f"not of use: {lost(MOTION_FREE, spoilt)}",
        ),
        Claim(
            "What takes over: the whole engine maps whatever motion-free ICP alone maps, and more",
            f"of use in {share(ENGINE, grid)} drives, without wheels in {share(NO_WHEELS, grid)}",
            usable[ENGINE.name] > usable[MOTION_FREE.name],
            f"not of use: {lost(ENGINE, grid)}; without wheels: {lost(NO_WHEELS, healthy)}",
        ),
        Claim(
            "A transport delay does no harm once it is known",
            f"{1000 * latest.delay_s:g} ms at 2 rad/s: ATE {pages.in_cm(told.ate_m)} cm {told.ate_deg:.2f} deg told, "
            f"{pages.in_cm(late.ate_m)} cm {late.ate_deg:.2f} deg not told, "
            f"{pages.in_cm(first.ate_m)} cm {first.ate_deg:.2f} deg without any",
            told.ate_m <= 1.5 * first.ate_m < late.ate_m
            and told.ate_deg <= 1.5 * first.ate_deg < late.ate_deg,
            "told: within 1.5 times the errors without delay, which untold it exceeds; the engine does not find it out",
        ),
    ]


def body(results: Results, logs: list[LogOutcome], plan: Plan) -> str:
    """The section in markdown."""
    frontier = [*pages.frontier_rows(results, plan), *pages.fault_rows(results, plan)]
    snapshot, ranged = (results[plan.base].scan_error_m[mode] for mode in ("none", "range"))
    return f"""A hall of 46 m by 24 m, a robot that can do it ({ACCELERATION_M_S2:g} m/s2 forward, {LATERAL_M_S2:g} m/s2 in
bends, {YAW_ACCELERATION_RAD_S2:g} rad/s2), a laser of 360 deg and 20 m with 2 cm of noise whose scans take the whole turn. Two drives: a
lap of the hall, and turns in place on a straight way. One factor is changed at a time; else wheels
are {100 * BASE.radius_error:g} % wrong in radius and track, read to 1/{BASE.ticks_per_turn} turn, slipping {1000 * BASE.slip_m_per_sqrt_m:g} mm per root m. Errors are those
of the body at the instants when scans were really sensed, so a delay is no error by itself. Every drive is
made once, with one seed: single cells near the border may fall on either side.

- *conventional*, *motion-free ICP*: the paper's two, alone: the wheels start a match and hold nothing; no search, no loops, no
  second pass;
- *whole engine*: default settings but `odometry.max_speed_m_s=10` (by default wheels faster than 5 m/s are taken for a jump);
- of use: ATE up to {pages.USABLE_M:g} m and {pages.USABLE_DEG:g} deg. A step of the front end has failed when it is off by more than
  {LOST_M:g} m or {LOST_DEG:g} deg. Blur: 5 cm cells that the keyframes' points hit, over those that they truly hit.

### Where it stops

![ATE over motion and sensor rate]({FRONTIER_PNG})

![ATE over motion and what is wrong with wheels and clocks]({FAULT_FRONTIER_PNG})

ATE in cm; the line is the border of what is of use. Up to where every drive is:

{pages.reach_table(frontier)}

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

{logs_body(logs)}
"""


def faults_body(results: Results, plan: Plan) -> str:
    """What the picture of faults shows, in numbers."""
    slip = results[plan.slipping()[-1]]
    small = results[plan.too_small()[-1]]
    coarse = results[plan.quantised()[-1]]
    free = pages.outcome(results, plan.base, NO_WHEELS)

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
