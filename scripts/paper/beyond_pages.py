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
    LADDER,
    MODES,
    MOTION_FREE,
    NO_WHEELS,
    Measured,
    Method,
    Outcome,
)

USABLE_M, USABLE_DEG = 0.1, 2.0  # ATE of a trajectory that is of use
SCAN_CURVES = {"none": "snapshot", "range": "range variant", "pose": "pose, wheels"}

Results = Mapping[Condition, Measured]


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A markdown table."""
    return "\n".join(f"| {' | '.join(row)} |" for row in (head, ["---"] * len(head), *rows))


def in_cm(metres: float) -> str:
    return f"{100.0 * metres:.1f}" if metres < 0.0995 else f"{100.0 * metres:.0f}"


# --- the frontier ----------------------------------------------------------------------------------------


def is_usable(outcome: Outcome) -> bool:
    return outcome.ate_m <= USABLE_M and outcome.ate_deg <= USABLE_DEG


def heat(results: Results, grid: Sequence[Sequence[Condition]], method: Method) -> Heat:
    """ATE of one method over a grid of drives, and where it is of use."""
    outcomes = [[results[c].of(method) for c in row] for row in grid]
    ate_m = np.array([[o.ate_m for o in row] for row in outcomes])
    return Heat(method.name, ate_m, np.array([[is_usable(o) for o in row] for row in outcomes]))


def heat_rows(results: Results, plan: Plan) -> list[HeatRow]:
    """Both grids of drives, rows by sensor rate."""
    laps = [[plan.lap(v, rate) for v in plan.speeds_m_s] for rate in plan.rates_hz]
    spins = [[plan.spin(w, rate) for w in plan.yaw_rates_rad_s] for rate in plan.rates_hz]
    return [
        HeatRow([heat(results, grid, m) for m in FRONTIER], columns, label, plan.rates_hz)
        for grid, columns, label in (
            (laps, plan.speeds_m_s, "speed, m/s"),
            (spins, plan.yaw_rates_rad_s, "turning in place, rad/s"),
        )
    ]


def reach(usable: BoolArray, columns: Sequence[float], line: int) -> str:
    """The fastest drive up to which every one is of use, at one sensor rate."""
    good = usable[line]
    count = len(good) if good.all() else int(np.argmin(good))
    if count == len(good):
        return f"{columns[-1]:g} (all)"
    return f"{columns[count - 1]:g}" if count else "none"


def reach_table(rows: Sequence[HeatRow]) -> str:
    head = ["", *(m.title for m in rows[0].maps)]
    lines = []
    for row in rows:
        for n, rate in enumerate(row.rates_hz):
            cells = [reach(m.usable, row.columns, n) for m in row.maps]
            lines.append([f"{row.columns_label}, {rate:g} Hz", *cells])
    return table(head, lines)


def named(conditions: Sequence[Condition]) -> str:
    """Drives of the grid in words, by rate of the laser: "3, 4 rad/s at 5 Hz"."""
    groups: dict[tuple[str, float], list[float]] = {}
    for c in conditions:
        unit, value = ("m/s", c.speed_m_s) if c.drive == "lap" else ("rad/s", c.yaw_rate_rad_s)
        groups.setdefault((unit, c.rate_hz), []).append(value)
    texts = [
        f"{', '.join(f'{v:g}' for v in values)} {unit} at {rate:g} Hz"
        for (unit, rate), values in groups.items()
    ]
    return "; ".join(texts) or "none"


# --- the scans' own error --------------------------------------------------------------------------------


def scan_panels(results: Results, plan: Plan) -> list[Panel]:
    """Error left in a scan over speed, turning and delay."""
    speeds = sorted({plan.slowest_m_s, *plan.speeds_m_s})
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
        curves["pose, optimised motion"] = [m.of(ENGINE).scan_error_m for m in measured]
        free = [_without_wheels(results, plan, c).of(NO_WHEELS).scan_error_m for c in conditions]
        curves["pose, optimised motion, no wheels"] = free
        out.append(Panel(title, label, x, dict(curves), y_label="error left in a scan (RMS), m"))
    return out


def _without_wheels(results: Results, plan: Plan, condition: Condition) -> Measured:
    """Where the same drive was mapped without wheels: no delay between clocks, no fault of a wheel matters there."""
    if any(outcome.method == NO_WHEELS.name for outcome in results[condition].outcomes):
        return results[condition]
    return results[plan.turning if condition.drive == "spins" else plan.base]


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
        by_method = {m.name: [results[c].of(m) for c in conditions] for m in (MOTION_FREE, ENGINE)}
        by_method[NO_WHEELS.name] = [_without_wheels(results, plan, c).of(NO_WHEELS) for c in conditions]
        ate_m = {name: [o.ate_m for o in outcomes] for name, outcomes in by_method.items()}
        blur = {name: [o.blur for o in outcomes] for name, outcomes in by_method.items()}
        ticks = [f"{v:g}" for v in values]
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
        measured = results[condition]
        rows.append([name, *(_rung(measured, method) for method in LADDER)])
    return table(["drive", *(method.name for method in LADDER)], rows)


def _rung(measured: Measured, method: Method) -> str:
    outcome = measured.of(method)
    lost = f" ({100 * outcome.lost_share:.0f} %)" if outcome.lost_share >= 0.005 else ""
    text = in_cm(outcome.ate_m)
    return f"**{text}**{lost}" if is_usable(outcome) else f"{text}{lost}"


def detail_table(results: Results, plan: Plan) -> str:
    """Every figure of the hard drives."""
    rows = []
    for name, condition in plan.hard_drives().items():
        for method in FRONTIER:
            o = results[condition].of(method)
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
