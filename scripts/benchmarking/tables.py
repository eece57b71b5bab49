"""What the runs cost and how good they are, table by table."""

from __future__ import annotations

from benchmarking.runs import Outcome

Table = list[list[str]]


def accuracy_table(outcomes: list[Outcome]) -> Table:
    head = ["log", "relations", "mean m", "median m", "p99 m", "mean deg", "median deg", "p99 deg"]
    rows = []
    for o in outcomes:
        if o.relations is None:
            continue
        matched, total = o.relations["matched"], o.relations["matched"] + o.relations["unmatched"]
        shift, turn = o.relations["translation_m"], o.relations["rotation_deg"]
        rows.append(
            [o.log, f"{matched:,} of {total:,}"]
            + [f"{shift[key]:.4f}" for key in ("mean", "median", "p99")]
            + [f"{turn[key]:.3f}" for key in ("mean", "median", "p99")]
        )
    return [head, *rows]


def cost_table(outcomes: list[Outcome]) -> Table:
    head = ["log", "scans", "travelled m", "log s", "CPU s", "times real time", "peak MB"]
    rows = []
    for o in outcomes:
        if o.failure is None and o.variant == "deskew on":
            counts, distances = o.summary["counts"], o.summary["distances"]
            size = [f"{counts['scans']:,}", f"{distances['travelled_m']:.0f}", f"{o.log_s:.0f}"]
            cost = [f"{o.cpu_s:.1f}", f"{o.real_time_factor:.0f}", f"{o.peak_mb:.0f}"]
            rows.append([o.log, *size, *cost])
    return [head, *rows]


def loops_table(outcomes: list[Outcome]) -> Table:
    head = [
        "log",
        "loops in use",
        "of these satisfied",
        "refused by the last solve",
        "taken out while mapping",
    ]
    rows = []
    for o in outcomes:
        if o.failure is None and o.variant == "deskew on":
            loops = o.summary["loops"]
            share = loops["in_use_satisfied_percent"]
            satisfied = f"{loops['in_use_satisfied']:,} ({share:.1f} %)" if share is not None else "-"
            refused, out = loops["refused_by_the_last_solve"], loops["taken_out_while_mapping"]
            rows.append([o.log, f"{loops['in_use']:,}", satisfied, f"{refused:,}", f"{out:,}"])
    return [head, *rows]


def growth_table(outcomes: list[Outcome]) -> Table:
    """What a metre costs while reading, quarter by quarter of the way."""
    head = ["log", "m per quarter", *(f"{n} quarter, ms per m" for n in ("1st", "2nd", "3rd", "4th"))]
    rows = []
    for o in outcomes:
        quarters = o.summary.get("reading_cost_by_quarter", [])
        if o.failure is None and o.variant == "deskew on" and quarters:
            costs = [f"{1e3 * q['cpu_s'] / max(q['travelled_m'], 1e-9):.1f}" for q in quarters]
            rows.append([o.log, f"{quarters[0]['travelled_m']:.0f}", *costs])
    return [head, *rows]


def crispness_table(outcomes: list[Outcome]) -> Table:
    head = ["log", "variant", "2 cm cells", "against off", "entropy nats"]
    plain = {
        o.log: o.summary["crispness"]["cells"]
        for o in outcomes
        if o.variant == "deskew off" and not o.failure
    }
    rows = []
    for o in outcomes:
        if o.failure is None and o.relations is None:
            cells = o.summary["crispness"]["cells"]
            change = f"{100.0 * (cells / plain[o.log] - 1.0):+.1f} %" if o.log in plain else "-"
            rows.append(
                [o.log, o.variant, f"{cells:,}", change, f"{o.summary['crispness']['entropy_nats']:.3f}"]
            )
    return [head, *rows]


def failures_table(outcomes: list[Outcome]) -> Table:
    return [
        ["log", "variant", "why it failed"],
        *([o.log, o.variant, o.failure] for o in outcomes if o.failure),
    ]


def tables(outcomes: list[Outcome]) -> list[tuple[str, Table]]:
    all_tables = [
        ("Relations error (Kuemmerle et al. 2009)", accuracy_table(outcomes)),
        ("Cost of the whole command, kernels compiled", cost_table(outcomes)),
        ("CPU time of reading per metre of the way, by its quarters", growth_table(outcomes)),
        (
            "Loops: satisfied is violated by less than 0.2 m and 1 deg after the final solve",
            loops_table(outcomes),
        ),
        ("Crispness of the re-projected points (lower is sharper)", crispness_table(outcomes)),
        ("Not mapped", failures_table(outcomes)),
    ]
    return [(title, table) for title, table in all_tables if len(table) > 1]
