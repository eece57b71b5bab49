"""The paper's two experiments: ICP by iteration, time of 15 iterations, and the maps, against the truth."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from paper import pictures
from paper.aisle_claims import PAPER_MS, Curves, convergence_claims, map_claims, time_claim
from paper.cases import ALL_SETUPS, MAP_SETUPS, Mapped, Task, map_all, mean_error
from paper.convergence import GUESSES, METHODS, converge, pairs_of, time_methods
from paper.rig import SQUARE, H, drive_through
from paper.section import Effort, Section

SEEDS, QUICK_SEEDS = (1, 2, 3, 4), (1,)
PAIRED_SEEDS = (1, 2)
QUICK_S = 12.0
EVERY, QUICK_EVERY = 10, 30  # of how many pairs of scans one is registered
TIMED_PAIRS, QUICK_TIMED_PAIRS = 60, 3
TITLES = {SQUARE: "Experiment 1, square aisle", H: "Experiment 2, H aisle"}


def run(effort: Effort) -> Section:
    worlds = (SQUARE,) if effort.quick else (SQUARE, H)
    first_s = QUICK_S if effort.quick else None
    times = {world: _times(world, effort.quick, first_s) for world in worlds}  # while nothing else runs
    curves = _all_curves(worlds, effort, first_s)
    seeds = QUICK_SEEDS if effort.quick else SEEDS
    setups = MAP_SETUPS if effort.quick else ALL_SETUPS
    tasks = [Task(world, seed, setup, first_s) for world in worlds for setup in setups for seed in seeds]
    mapped = map_all(tasks, effort.jobs)
    body, claims = [INTRODUCTION], []
    for world in worlds:
        maps = {s.name: [m for m in mapped if (m.task.world, m.task.setup) == (world, s)] for s in setups}
        body += [f"### {TITLES[world]}", *_convergence_part(world, curves[world], effort.figures)]
        body += [*_time_part(world, times[world]), *_map_part(world, maps, effort.figures)]
        claims += [
            *convergence_claims(world, curves[world]),
            time_claim(world, times[world], curves[world]),
            *map_claims(world, maps),
        ]
    measured: dict[str, Any] = {
        world: {
            "convergence": {
                f"{method}, {guess}": {
                    "x_m": c.x_m,
                    "y_m": c.y_m,
                    "residual_m": c.residual_m,
                    "pairs": c.pairs,
                }
                for (method, guess), c in curves[world].items()
            },
            "ms_for_15_iterations": times[world],
            "maps": [
                {"setup": m.task.setup.name, "seed": m.task.seed, **vars(m.error)}
                for m in mapped
                if m.task.world == world
            ],
        }
        for world in worlds
    }
    return Section("The paper's two experiments", "\n\n".join(body), claims, measured)


INTRODUCTION = (
    "**ICP by iteration.** Each scan of 682 beams is registered to the one before it, 100 ms earlier. The error is "
    "where its registered points lie against where they truly are, X along the robot's heading, Y across; "
    "noise of 2 cm is in it, so no curve can reach zero. Partners are sought within 0.5 m. Both methods "
    "start from the same guess: once from no motion at all, as a scan matcher without wheels would, once from the "
    "wheels, whose motion the motion-free method needs anyway.\n\n"
    "**Maps.** The paper's system is scan-to-map ICP that starts from the wheels and compensates with them, nothing more: "
    "`--preset conventional-icp` or `motion-free-icp`, whole scans (`icp.point_spacing_m=0`), no loops, no second pass, wheels too unsure "
    "(`odometry.sigma_...`) to hold a match where it wants to go. *Wheels as prior*: the same, with the wheels' default "
    "uncertainty. The trajectory is laid on the true one as a whole; a wall's error is the mean signed distance of the "
    "map's points, per 10 cm of wall. *Drift left out*: every 5 m of driving is laid on the truth by itself, so that what is left is the "
    "error of the scans and of their matching."
)


# --- what is measured ----------------------------------------------------------------------------------


def _times(world: str, quick: bool, first_s: float | None) -> dict[str, float]:
    pairs = pairs_of(drive_through(world, first_s), SEEDS[0], 1)
    count = QUICK_TIMED_PAIRS if quick else TIMED_PAIRS
    chosen = np.linspace(0, len(pairs) - 1, count).astype(np.int64)
    return time_methods([pairs[k] for k in chosen], 1 if quick else 3)


def _curves(world: str, guess: str, quick: bool, first_s: float | None) -> Curves:
    drive = drive_through(world, first_s)
    seeds, every = (QUICK_SEEDS, QUICK_EVERY) if quick else (PAIRED_SEEDS, EVERY)
    pairs = [pair for seed in seeds for pair in pairs_of(drive, seed, every)]
    return {(method.name, guess): converge(pairs, method, guess) for method in METHODS}


def _all_curves(worlds: tuple[str, ...], effort: Effort, first_s: float | None) -> dict[str, Curves]:
    jobs = [(world, guess, effort.quick, first_s) for world in worlds for guess in GUESSES]
    if effort.jobs == 1:
        found = [_curves(*job) for job in jobs]
    else:
        with ProcessPoolExecutor(effort.jobs) as pool:
            found = list(pool.map(_curves, *zip(*jobs, strict=True)))
    out: dict[str, Curves] = {world: {} for world in worlds}
    for (world, *_), curves in zip(jobs, found, strict=True):
        out[world] |= curves
    return out


# --- the page ------------------------------------------------------------------------------------------


def _convergence_part(world: str, curves: Curves, folder: Path | None) -> list[str]:
    lines = [
        "| RMS error, mm | from | X: start | X: 1 | X: 5 | X: 15 | Y: start | Y: 1 | Y: 5 | Y: 15 | seen by the ICP: 15 |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for (method, guess), c in curves.items():
        figures = [*c.x_m[[0, 1, 5, 15]], *c.y_m[[0, 1, 5, 15]], c.residual_m[15]]
        lines.append(f"| {method} | {guess} | {' | '.join(f'{1e3 * v:.1f}' for v in figures)} |")
    out = ["\n".join(lines)]
    if folder is not None:
        colours = {METHODS[0].name: pictures.VERMILION, METHODS[1].name: pictures.BLUE}
        drawn = [
            pictures.Curve(
                f"{method.split(' (')[0]}, {guess}", colours[method], guess == GUESSES[0], c.x_m, c.y_m
            )
            for (method, guess), c in curves.items()
        ]
        pictures.draw_convergence(drawn, folder / f"{world}-icp.png")
        figure = 14 if world == SQUARE else 17
        pairs = next(iter(curves.values())).pairs
        out += [
            f"![ICP by iteration]({world}-icp.png)",
            f"*Figure {figure} of the paper, from our runs: {pairs} pairs of scans.*",
        ]
    return out


def _time_part(world: str, ms: dict[str, float]) -> list[str]:
    conventional, motion_free = (ms[method.name] for method in METHODS)
    paper = PAPER_MS[world]
    return [
        "| time for 15 iterations | conventional | motion-free | ratio |\n| --- | --- | --- | --- |\n"
        f"| the paper | {paper[0]:.0f} ms | {paper[1]:.0f} ms | {paper[1] / paper[0]:.2f} |\n"
        f"| here, one core | {conventional:.1f} ms | {motion_free:.1f} ms | {motion_free / conventional:.2f} |"
    ]


def _map_part(world: str, maps: dict[str, list[Mapped]], folder: Path | None) -> list[str]:
    lines = [
        "| map | walls, mm: RMS | worst log | walls, drift left out, mm | single points, mm | ATE, m | ATE, deg |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for name, group in maps.items():
        cells = [
            name,
            f"{1e3 * mean_error(group, 'rms_m'):.1f}",
            f"{1e3 * max(m.error.rms_m for m in group):.1f}",
            f"{1e3 * mean_error(group, 'local_rms_m'):.1f}",
            f"{1e3 * mean_error(group, 'points_rms_m'):.0f}",
            f"{mean_error(group, 'ate_m'):.3f}",
            f"{mean_error(group, 'ate_deg'):.2f}",
        ]
        lines.append(f"| {' | '.join(cells)} |")
    out = ["\n".join(lines)]
    if folder is not None:
        panels = {
            f"{setup.name}\nwalls {1e3 * maps[setup.name][0].error.rms_m:.0f} mm RMS": maps[setup.name][
                0
            ].points_m
            for setup in MAP_SETUPS
        }
        pictures.draw_maps(drive_through(world).world, panels, folder / f"{world}-maps.png")
        figure = 13 if world == SQUARE else 16
        out += [
            f"![Maps]({world}-maps.png)",
            f"*Figure {figure} of the paper, from our runs, and mfslam's own map beside it: points of the first "
            "log's map, true walls as lines.*",
        ]
    return out
