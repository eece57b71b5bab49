"""What a run comes to: from the engine and its solution to the map, the figures and the folder."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from drivers.base import LogInfo
from mfslam.config import Config
from mfslam.mapping import render_map
from mfslam.memory import give_memory_back
from mfslam.metrics import compare_motions
from mfslam.observability import open_stretches, tears
from mfslam.output import json_text, summarise, write_atomically, write_run
from mfslam.slam import Slam, Solution
from mfslam.types import Findings, MfslamError, OpenStretch, RunResult

OPEN_TOLD_M = 1.0  # shorter stretches are drawn and listed, but are no finding


@dataclass
class Outcome:
    """A finished run: the result, what summary.json says of it, and whether it was cut short."""

    result: RunResult
    summary: dict[str, Any]
    interrupted: bool


def outcome_of(
    slam: Slam, solution: Solution, config: Config, info: LogInfo, findings: Findings, interrupted: bool,
    start_cpu_s: float,
) -> Outcome:  # fmt: skip
    """Draw the map of a solved run and sum it up; the engine gives its matching data back.

    ``findings``: of the log; those of the engine and the map are added. Raises MfslamError where no scan has a
    usable range.
    """
    slam.release()
    give_memory_back()
    with slam.clock.time("map"), ThreadPoolExecutor(1) as thread:
        comparison = thread.submit(compare_deskewing, slam, solution, config)
        grid, points = render_map(slam.scans, solution.world_T_reference, solution.twists, config, findings)
        sharpness = comparison.result()
    if not len(points.points_m):
        raise MfslamError(
            f"{info.path}: none of its {len(slam.scans)} scans has a usable range: nothing to map"
        )
    findings.merge(slam.findings)
    stretches = open_stretches(solution.world_T_body[solution.keyframes], solution.keyframes, solution.edges)
    torn = told_tears(solution)
    tell_open(stretches, torn, solution, findings)
    result = RunResult(
        solution.stamps_ns, solution.world_T_body, solution.keyframes, solution.edges, grid, points, findings,
        solution.covariances, stretches,
    )  # fmt: skip
    result.summary = {"deskew": sharpness, **({"tears": torn} if torn else {})} | run_summary(
        info, slam, solution, interrupted, time.process_time() - start_cpu_s
    )
    return Outcome(result, summarise(result), interrupted)


def compare_deskewing(slam: Slam, solution: Solution, config: Config) -> dict[str, Any]:
    """How sharp the hits are from the final poses, without deskewing and with the motion as it was known."""
    while_mapping = np.array([np.zeros(3) if step.twist is None else step.twist[:3] for step in slam.steps])
    motions = {
        "off": np.zeros_like(while_mapping),
        "while_mapping": while_mapping,
        "optimised": solution.twists,
    }
    return compare_motions(slam.scans, solution.world_T_reference, motions, config)


def told_tears(solution: Solution) -> list[dict[str, float]]:
    """Where the path is torn: from and to which scan, and how unsure the way between is (one sigma)."""
    stamps_s = solution.stamps_ns * 1e-9
    return [
        {
            "from_stamp_s": float(stamps_s[solution.keyframes[k - 1]]),
            "to_stamp_s": float(stamps_s[solution.keyframes[k]]),
            "sigma_m": float(np.sqrt(np.linalg.eigvalsh(covariance[:2, :2])[1])),
            "sigma_deg": float(np.degrees(np.sqrt(covariance[2, 2]))),
        }
        for k, covariance in tears(solution.edges).items()
    ]


def tell_open(
    stretches: list[OpenStretch], torn: list[dict[str, float]], solution: Solution, findings: Findings
) -> None:
    """A finding for the stretches that are longer than a keyframe step or two, and one for tears."""
    if torn:
        findings.add(
            "torn-path",
            "neither scans nor wheels tell the way there, and no loop ties both sides: what comes after stands where inertia "
            "led, and its covariance says how surely, see tears",
            f"{torn[0]['to_stamp_s']:.6f} s",
            len(torn),
        )
    long = [stretch for stretch in stretches if stretch.travelled_m >= OPEN_TOLD_M]
    if long:
        metres = sum(stretch.travelled_m for stretch in long)
        findings.add(
            "open-direction",
            f"the scans left a direction open for {metres:.0f} m of the way: wheels or inertia decided there, "
            "see open_stretches",
            f"{solution.stamps_ns[long[0].first_scan] * 1e-9:.6f} s",
            len(long),
        )


def run_summary(
    info: LogInfo, slam: Slam, solution: Solution, interrupted: bool, cpu_s: float
) -> dict[str, Any]:
    """What only the run knows; `mfslam.output.summarise` adds counts, distances and residuals."""
    statistics = slam.loops.statistics
    stamps = solution.stamps_ns
    log_s = float(stamps.max() - stamps.min()) * 1e-9
    return {
        "log": {"path": str(info.path), "format": info.format},
        "interrupted": interrupted,
        "real_time_factor": log_s / max(cpu_s, 1e-9),
        "timings_s": {**slam.clock.seconds, "total": cpu_s},
        "reading_cost_by_quarter": reading_cost(slam),
        "loops": {
            "searches": statistics.searches,
            "places_tried": statistics.places_tried,
            "accepted": statistics.accepted,
            "taken_out_while_mapping": statistics.taken_out,
            "brought_back_while_mapping": statistics.brought_back,
            "refused": dict(sorted(statistics.refused.items())),
        },
        "searched_fits": sum(step.searched for step in slam.steps),
        "odometry_anomalies": [
            {"scan": n, "stamp_s": slam.scans[n].stamp_ns * 1e-9} for n in slam.odometry_jumps
        ],
        "wheels": slam.wheel_errors.as_json() if slam.wheel_errors is not None else {},
    }


def reading_cost(slam: Slam) -> list[dict[str, float]]:
    """Way driven and CPU time of the reading, for each quarter of the way: does a metre cost more later on?"""
    travel_m, cpu_s = np.array(slam.loops.travel_m), np.array(slam.cpu_s)
    if len(travel_m) < 2:
        return []
    ends = np.searchsorted(travel_m, np.linspace(0.0, travel_m[-1], 5)).clip(max=len(travel_m) - 1)
    return [
        {"travelled_m": float(m), "cpu_s": float(s)}
        for m, s in zip(np.diff(travel_m[ends]), np.diff(cpu_s[ends]), strict=True)
    ]


def leave(outcome: Outcome, config: Config, folder: Path, json_file: Path | None) -> None:
    """Write the folder, and the summary where else it is wanted."""
    write_run(outcome.result, config, folder, outcome.summary)
    if json_file is not None:
        write_atomically(json_file, json_text(outcome.summary).encode())
