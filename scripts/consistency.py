#!/usr/bin/env python3
"""Whether stated covariances are true: normalised errors of edges and trajectories against exact truth.

Simulated logs are mapped with the default settings of their sensor. The error of every edge and of the final
trajectory, normalised by its own covariance, should be chi2 distributed: the mean of e^T C^-1 e over its degrees
of freedom (NEES) is 1 and 95 % of the errors lie within the 95 % quantile. Above 1 the covariance claims too much,
below 1 too little. The square root is how many times larger the errors are than stated.

    scripts/consistency.py                                    # all cases, tables on the terminal
    scripts/consistency.py --only urg --seeds 3 --set icp.independent_share=0.3
    scripts/consistency.py --markdown docs/consistency.md --json consistency.json
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
from collections.abc import Iterable
from functools import partial
from pathlib import Path

import numpy as np
from benchmarking.page import as_markdown, replace_section
from robustness import make_simulation
from robustness_cases import Case, fast
from scipy.special import chdtri

from drivers.simulator import laser_model, load_world
from mfslam import se2
from mfslam.adjustment import AdjustedInformation
from mfslam.deskew import reference_offset_s
from mfslam.graph import GraphInformation
from mfslam.metrics import ate
from mfslam.output import write_atomically
from mfslam.settings import load, preset_path
from mfslam.slam import Slam
from mfslam.types import Edge, FloatArray, MfslamError

GROSS_M, GROSS_RAD = (
    0.3,
    0.1,
)  # an edge farther off is an outlier: counted apart, not part of its kind's noise
LEAST_SIGMA_M = 0.5  # directions less sure than this are open: the edge says nothing there
SPANS_M = (1.0, 5.0, 20.0, 100.0)
WITHIN = 0.95


def cases() -> list[Case]:
    """Every world with every sensor that sees enough of it."""
    mount = (0.1, 0.0, 0.0)
    out = [
        Case(f"{name}, fast", None, partial(load_world, name), fast)
        for name in ("demo", "office:7", "h-aisle")
    ]
    for sensor, names in {
        "urg-04lx": ("demo", "office", "square-aisle", "h-aisle"),
        "sick-lms200": ("demo", "office:7", "hall", "h-aisle"),
        "rplidar-a1": ("demo", "office", "h-aisle"),
        "utm-30lx": ("demo", "hall"),
    }.items():
        for name in names:
            model = partial(laser_model, sensor, mount)
            out.append(Case(f"{name}, {sensor}", None, partial(load_world, name), model, preset=sensor))
    return out


# --- one run -------------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True, eq=False)
class Errors:
    """Normalised errors of one kind in one run: ``chi2`` (N,) with ``dof`` (N,), and ``parts`` (N, 3): the error in
    sigmas along the surest and the least sure direction of translation and of the turn, NaN where open."""

    chi2: FloatArray
    dof: FloatArray
    parts: FloatArray
    gross: int = 0

    @property
    def nees(self) -> float:
        return float(self.chi2.sum() / max(1.0, self.dof.sum()))

    @property
    def within(self) -> float:
        if not len(self.chi2):
            return float("nan")
        return float(np.mean(self.chi2 <= chdtri(self.dof, 1.0 - WITHIN)))

    def part_rms(self) -> FloatArray:
        seen = np.isfinite(self.parts).any(axis=0)
        out = np.full(3, np.nan)
        out[seen] = np.sqrt(np.nanmean(np.square(self.parts[:, seen]), axis=0))
        return out


def joined(many: Iterable[Errors]) -> Errors:
    every = list(many)
    return Errors(
        np.concatenate([e.chi2 for e in every]),
        np.concatenate([e.dof for e in every]),
        np.concatenate([e.parts for e in every]),
        sum(e.gross for e in every),
    )


def normalised(errors: FloatArray, covariances: FloatArray) -> Errors:
    """Of errors (N, 3) in a tangent with covariances (N, 3, 3); open directions are left out."""
    values, vectors = np.linalg.eigh(covariances[:, :2, :2])
    chi2, dof, parts = np.zeros(len(errors)), np.zeros(len(errors)), np.full((len(errors), 3), np.nan)
    for n, (error, covariance) in enumerate(zip(errors, covariances, strict=True)):
        basis = np.zeros((3, 3))
        basis[:2, :2], basis[2, 2] = vectors[n], 1.0
        seen = np.array([*(values[n] < LEAST_SIGMA_M**2), covariance[2, 2] < LEAST_SIGMA_M**2])
        if not seen.any():
            continue
        e, c = (basis.T @ error)[seen], (basis.T @ covariance @ basis)[np.ix_(seen, seen)]
        chi2[n], dof[n] = e @ np.linalg.solve(c, e), seen.sum()
        parts[n, seen] = e / np.sqrt(np.diag(c))
    return Errors(chi2[dof > 0], dof[dof > 0], parts[dof > 0])


def of_edges(edges: list[Edge], truth: FloatArray) -> Errors:
    """Errors of edges against true keyframe poses (K, 3)."""
    if not edges:
        return Errors(np.zeros(0), np.zeros(0), np.zeros((0, 3)))
    i, j = np.array([e.i for e in edges]), np.array([e.j for e in edges])
    errors = se2.log(se2.between(np.array([e.i_T_j for e in edges]), se2.between(truth[i], truth[j])))
    gross = (np.hypot(errors[:, 0], errors[:, 1]) > GROSS_M) | (np.abs(errors[:, 2]) > GROSS_RAD)
    information = np.array([e.information for e in edges]) + 1e-6 * np.eye(3)
    covariances = np.asarray(np.linalg.inv(information), dtype=np.float64)
    # an edge that leaves a direction open may be far off along it
    gross &= np.sqrt(np.linalg.eigvalsh(covariances)[:, 2]) < LEAST_SIGMA_M
    good = ~gross
    return dataclasses.replace(normalised(errors[good], covariances[good]), gross=int(gross.sum()))


def of_trajectory(
    estimate: FloatArray,
    truth: FloatArray,
    information: GraphInformation | AdjustedInformation,
    most: int = 150,
) -> dict[str, Errors]:
    """Errors of the motion between keyframes 1, 5, 20 and 100 m of driving apart, under the joint marginals, and
    of the keyframes themselves relative to the first."""
    count = len(estimate)
    travel = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(estimate[:, :2], axis=0).T))])
    off = se2.log(se2.between(se2.between(estimate[:1], estimate), se2.between(truth[:1], truth)))
    out = {"from the start": normalised(off[1:], information.marginals()[1:])}
    for span in SPANS_M:
        i = np.arange(count)
        j = np.searchsorted(travel, travel + span)
        i, j = i[j < count], j[j < count]
        chosen = np.linspace(0, len(i) - 1, min(most, len(i))).astype(np.int64) if len(i) else i
        i, j = i[chosen], j[chosen]
        errors = se2.log(se2.between(se2.between(estimate[i], estimate[j]), se2.between(truth[i], truth[j])))
        out[f"over {span:g} m"] = normalised(errors, information.relative_covariances(i, j))
    return out


@dataclasses.dataclass(frozen=True, eq=False)
class Run:
    """Normalised errors by kind, and the root mean square error of the trajectory."""

    errors: dict[str, Errors]
    ate_m: float
    ate_deg: float


def run_case(case: Case, settings: Iterable[str] = ()) -> Run:
    simulation, _ = make_simulation(case)
    slam = Slam(load([preset_path(case.preset)], [*case.settings, *settings]))
    for message in simulation.messages:
        slam.feed(message)
    slam._place_waiting()
    online = slam.graph.live_edges()
    solution = slam.finish()
    truth = simulation.truth_world_T_body[solution.keyframes]
    told = slam.scans[0].laser
    at_reference = simulation.motion.at(simulation.instants_s + reference_offset_s(told))[solution.keyframes]
    final = solution.edges
    kept = [e for e in final if e.weight >= 0.5]
    out = {
        "scan, online": of_edges([e for e in online if e.kind == "scan"], at_reference),
        "wheels": of_edges([e for e in kept if e.kind == "odometry"], truth),
        "loop": of_edges([e for e in kept if e.kind == "loop"], truth),
        "scan": of_edges([e for e in final if e.kind == "scan"], truth),
    }
    estimate = solution.world_T_body[solution.keyframes]
    out |= of_trajectory(estimate, truth, slam.information or GraphInformation(estimate, final))
    absolute = ate(simulation.truth_world_T_body, solution.world_T_body)
    return Run(out, absolute.translation_m.rmse, absolute.rotation_deg.rmse)


# --- tables --------------------------------------------------------------------------------------------

HEAD = ["kind", "number", "NEES", "within 95 %", "across", "along", "turn", "outliers"]
Results = dict[str, list[Run]]  # case -> one per seed


def band(values: FloatArray) -> str:
    """Mean NEES over the runs, which are independent, and its 95 % band."""
    spread = 1.96 * float(np.std(values, ddof=1)) / np.sqrt(len(values)) if len(values) > 1 else 0.0
    return f"{np.mean(values):.2f} ± {spread:.2f}"


def kind_rows(runs: list[Run]) -> list[list[str]]:
    rows = []
    for kind in runs[0].errors:
        every = [run.errors[kind] for run in runs if len(run.errors[kind].chi2)]
        if not every:
            continue
        whole = joined(every)
        parts = ["-" if np.isnan(p) else f"{p:.2f}" for p in whole.part_rms()]
        nees = band(np.array([e.nees for e in every]))
        rows.append(
            [kind, str(len(whole.chi2)), nees, f"{100 * whole.within:.0f} %", *parts, str(whole.gross)]
        )
    return rows


def case_rows(results: Results) -> list[list[str]]:
    kinds = list(next(iter(results.values()))[0].errors)
    rows = [["case", "ATE m", "ATE deg", *kinds]]
    for name, runs in results.items():
        row = [name, f"{np.mean([r.ate_m for r in runs]):.4f}", f"{np.mean([r.ate_deg for r in runs]):.3f}"]
        for kind in kinds:
            whole = joined(run.errors[kind] for run in runs)
            row.append(f"{whole.nees:.2f}" if len(whole.chi2) else "-")
        rows.append(row)
    return rows


def as_text(table: list[list[str]]) -> str:
    widths = [max(len(row[c]) for row in table) for c in range(len(table[0]))]
    return "\n".join(
        "  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in table
    )


def figures(results: Results) -> dict[str, list[dict[str, object]]]:
    """Everything measured, JSON-able: per case one entry per seed."""
    return {
        name: [
            {"ate_m": run.ate_m, "ate_deg": run.ate_deg}
            | {
                kind: {
                    "number": len(e.chi2),
                    "nees": e.nees,
                    "within": e.within,
                    "rms": e.part_rms().tolist(),
                }
                for kind, e in run.errors.items()
                if len(e.chi2)
            }
            for run in runs
        ]
        for name, runs in results.items()
    }


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--only", action="append", default=[], help="cases whose name holds this word (may repeat)"
    )
    parser.add_argument("--set", action="append", default=[], dest="settings", help="stage.key=value")
    parser.add_argument("--seeds", type=int, default=2, help="runs per case (2)")
    parser.add_argument("--json", type=Path, help="write all figures there")
    parser.add_argument("--markdown", type=Path, help="put the tables into this page")
    args = parser.parse_args()
    chosen = [c for c in cases() if not args.only or any(word in c.name for word in args.only)]
    if not chosen:
        parser.error(f"no case holds any of {args.only}")
    results: Results = {}
    for case in chosen:
        for seed in range(1, args.seeds + 1):
            results.setdefault(case.name, []).append(
                run_case(dataclasses.replace(case, seed=seed), args.settings)
            )
        print(
            f"{case.name}\n{as_text([HEAD, *kind_rows(results[case.name])])}\n", file=sys.stderr, flush=True
        )
    summary = kind_rows([run for runs in results.values() for run in runs])
    by_case = case_rows(results)
    print(as_text([HEAD, *summary]), as_text(by_case), sep="\n\n")
    if args.json is not None:
        write_atomically(args.json, json.dumps(figures(results), indent=1).encode())
    if args.markdown is not None:
        tables = "\n\n".join(as_markdown(table) for table in ([HEAD, *summary], by_case))
        replace_section(args.markdown, "consistency", tables)
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except MfslamError as error:
        sys.exit(f"consistency: {error}")
