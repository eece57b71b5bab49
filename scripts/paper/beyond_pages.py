"""Beyond the paper: what was measured, as tables and curves."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from mfslam.types import BoolArray
from paper.beyond_conditions import Condition
from paper.beyond_figures import Heat, HeatRow, Panel
from paper.beyond_logs import LogOutcome
from paper.beyond_plan import BASE, Plan
from paper.beyond_runs import (
    ENGINE,
    FRONTIER,
    JOINT,
    LADDER,
    MODES,
    MOTION_FREE,
    WITH_WHEELS,
    Measured,
    Method,
    Outcome,
    drive_for,
)

USABLE_M, USABLE_DEG = 0.1, 2.0  # ATE of a trajectory that is of use
SPEED, TURNING = "speed, m/s", "turning in place, rad/s"
SCAN_CURVES = {"none": "snapshot", "range": "range variant", "pose": "pose, wheels"}

Results = Mapping[Condition, Measured]


def outcome(results: Results, condition: Condition, method: Method) -> Outcome:
    """How a method did on a drive."""
    return results[drive_for(condition, method)].of(method)


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A markdown table."""
    return "\n".join(f"| {' | '.join(row)} |" for row in (head, ["---"] * len(head), *rows))


def in_cm(metres: float) -> str:
    return f"{100.0 * metres:.1f}" if metres < 0.0995 else f"{100.0 * metres:.0f}"


# --- the frontier ----------------------------------------------------------------------------------------


def is_usable(o: Outcome) -> bool:
    return o.ate_m <= USABLE_M and o.ate_deg <= USABLE_DEG


def heat(results: Results, grid: Sequence[Sequence[Condition]], method: Method) -> Heat:
    """ATE of one method over a grid of drives, and where it is of use."""
    outcomes = [[outcome(results, c, method) for c in row] for row in grid]
    ate_m = np.array([[o.ate_m for o in row] for row in outcomes])
    return Heat(method.name, ate_m, np.array([[is_usable(o) for o in row] for row in outcomes]))


def frontier_rows(results: Results, plan: Plan) -> list[HeatRow]:
    """What the robot does, over the laser's rate."""
    rates, label = [f"{rate:g}" for rate in plan.rates_hz], "turns of the laser, Hz"
    speeds, yaw_rates = numbers(plan.speeds_m_s), numbers(plan.yaw_rates_rad_s)
    return [
        heat_row(results, FRONTIER, plan.laps(), speeds, SPEED, rates, label),
        heat_row(results, FRONTIER, plan.spins(), yaw_rates, TURNING, rates, label),
    ]


def fault_rows(results: Results, plan: Plan) -> list[HeatRow]:
    """What the robot does, over what is wrong with its wheels and clocks; a laser of 10 Hz. Without wheels it
    makes no difference."""
    slips, delays = numbers(in_percent(plan.slips)), numbers(in_ms(plan.delays_s))
    speeds, yaw_rates = numbers(plan.speeds_m_s), numbers(plan.yaw_rates_rad_s)
    return [
        heat_row(results, WITH_WHEELS, plan.slipping_laps(), speeds, SPEED, slips, "slip, cm per root m"),
        heat_row(results, WITH_WHEELS, plan.late_spins(), yaw_rates, TURNING, delays, "unknown delay, ms"),
    ]


def heat_row(
    results: Results,
    methods: Sequence[Method],
    grid: Sequence[Sequence[Condition]],
    columns: Sequence[str],
    columns_label: str,
    lines: Sequence[str],
    lines_label: str,
) -> HeatRow:
    return HeatRow([heat(results, grid, m) for m in methods], columns, columns_label, lines, lines_label)


def numbers(values: Sequence[float]) -> list[str]:
    return [f"{value:g}" for value in values]


def reach(usable: BoolArray, columns: Sequence[str], line: int) -> str:
    """The fastest drive up to which every one is of use, at one sensor rate."""
    good = usable[line]
    count = len(good) if good.all() else int(np.argmin(good))
    if count == len(good):
        return f"{columns[-1]} (all)"
    return columns[count - 1] if count else "none"


def reach_table(rows: Sequence[HeatRow]) -> str:
    head = ["", *(m.title for m in rows[0].maps)]
    lines = []
    for row in rows:
        for n, value in enumerate(row.lines):
            cells = [reach(m.usable, row.columns, n) for m in row.maps]
            lines.append([f"{row.columns_label}; {row.lines_label}: {value}", *cells])
    return table(head, lines)


def named(conditions: Sequence[Condition]) -> str:
    """Drives of the grids in words, by what else there is: "3, 4 rad/s at 5 Hz"."""
    groups: dict[str, list[str]] = {}
    for c in conditions:
        unit, value = ("m/s", c.speed_m_s) if c.drive == "lap" else ("rad/s", c.yaw_rate_rad_s)
        text = f"{unit} at {c.rate_hz:g} Hz"
        if c.slip_m_per_sqrt_m != BASE.slip_m_per_sqrt_m:
            text += f" with {100.0 * c.slip_m_per_sqrt_m:g} cm of slip"
        if c.delay_s:
            text += f", {1000.0 * c.delay_s:g} ms late"
        groups.setdefault(text, []).append(f"{value:g}")
    return "; ".join(f"{', '.join(values)} {text}" for text, values in groups.items()) or "none"


# --- the scans' own error --------------------------------------------------------------------------------


def scan_panels(results: Results, plan: Plan) -> list[Panel]:
    """Error left in a scan over speed, turning and delay."""
    speeds = plan.speeds_m_s
    rate, yaw_rates = BASE.rate_hz, plan.yaw_rates_rad_s
    grids: list[tuple[str, str, Sequence[float], list[Condition]]] = [
        ("round the hall, 10 Hz", "speed, m/s", speeds, [plan.lap(v, rate) for v in speeds]),
        ("turning in place, 10 Hz", "yaw rate, rad/s", yaw_rates, [plan.spin(w, rate) for w in yaw_rates]),
        ("turning at 2 rad/s, 10 Hz", "delay nobody knows of, ms", in_ms(plan.delays_s), plan.late(False)),
    ]
    out = []
    for title, label, x, conditions in grids:
        measured = [results[c] for c in conditions]
        curves = {SCAN_CURVES[mode]: [m.scan_error_m[mode] for m in measured] for mode in MODES}
        curves["pose, optimised motion"] = [outcome(results, c, ENGINE).scan_error_m for c in conditions]
        free = [outcome(results, c, JOINT).scan_error_m for c in conditions]
        curves["pose, optimised motion, no wheels"] = free
        out.append(Panel(title, label, x, dict(curves), y_label="error left in a scan (RMS), m"))
    return out


# --- faults of wheels and clocks -------------------------------------------------------------------------


def fault_panels(results: Results, plan: Plan) -> list[list[Panel]]:
    """ATE and blur over every fault: a row each."""
    turning, lap = "turning, 2 rad/s", "lap, 3 m/s"
    errors = in_percent(plan.wheel_errors)
    faults: list[tuple[str, str, Sequence[float], list[Condition]]] = [
        (turning, "delay, unknown, ms", in_ms(plan.delays_s), plan.late(False)),
        (turning, "delay, known, ms", in_ms(plan.delays_s), plan.late(True)),
        (turning, "pulses per turn", plan.pulses, plan.quantised()),
        (lap, "slip, cm per root m", in_percent(plan.slips), plan.slipping()),
        (lap, "radius error, %", errors, plan.too_small()),
        (turning, "track error, %", errors, plan.too_wide()),
    ]
    rows: list[list[Panel]] = [[], []]
    for title, label, values, conditions in faults:
        methods = (MOTION_FREE, ENGINE, JOINT)
        by_method = {m.name: [outcome(results, c, m) for c in conditions] for m in methods}
        ate_m = {name: [o.ate_m for o in outcomes] for name, outcomes in by_method.items()}
        blur = {name: [o.blur for o in outcomes] for name, outcomes in by_method.items()}
        ticks = numbers(values)
        rows[0].append(Panel(title, "", values, dict(ate_m), ticks, "ATE (RMS), m", USABLE_M))
        rows[1].append(Panel("", label, values, dict(blur), ticks, "blur of the map", 1.0, False))
    return rows


def in_ms(seconds: Sequence[float]) -> list[float]:
    return [1000.0 * s for s in seconds]


def in_percent(shares: Sequence[float]) -> list[float]:
    return [100.0 * s for s in shares]


# --- what takes over -------------------------------------------------------------------------------------


def ladder_table(results: Results, plan: Plan) -> str:
    rows = []
    for name, condition in plan.hard_drives().items():
        rows.append([name, *(_rung(outcome(results, condition, method)) for method in LADDER)])
    return table(["drive", *(method.name for method in LADDER)], rows)


def _rung(o: Outcome) -> str:
    lost = f" ({100 * o.lost_share:.0f} %)" if o.lost_share >= 0.005 else ""
    return f"**{in_cm(o.ate_m)}**{lost}" if is_usable(o) else f"{in_cm(o.ate_m)}{lost}"


def detail_table(results: Results, plan: Plan) -> str:
    """Every figure of the hard drives."""
    rows = []
    for name, condition in plan.hard_drives().items():
        for method in FRONTIER:
            o = outcome(results, condition, method)
            rows.append(
                [
                    *(name, method.name, in_cm(o.scan_error_m), in_cm(o.step_m), f"{o.step_deg:.2f}"),
                    *(f"{100 * o.lost_share:.1f}", f"{100 * o.searched_share:.1f}", str(o.loops)),
                    *(in_cm(o.ate_m), f"{o.ate_deg:.2f}", f"{o.blur:.2f}"),
                ]
            )
    head = ["drive", "method", "scan left cm", "step cm", "step deg", "failed %", "searched %", "loops", "ATE cm", "ATE deg", "blur"]  # fmt: skip
    return table(head, rows)


def logs_table(outcomes: Sequence[LogOutcome]) -> str:
    rows = []
    for o in outcomes:
        error = "" if o.relations_m is None else f"{o.relations_m:.4f} / {o.relations_deg:.2f}"
        rows.append([o.log, o.variant, str(o.scans), error, f"{o.cells:,}", f"{o.entropy_nats:.3f}"])
    return table(["log", "motion from", "scans", "relations, m / deg", "2 cm cells", "entropy, nats"], rows)
