"""What the factor graph adds to the paper's system: loops, wheel factors and the second pass, on and off."""

from __future__ import annotations

from itertools import product

import numpy as np

from paper.cases import Mapped, Setup, Task, map_all, mean_error
from paper.rig import SPOKEN, SQUARE, H
from paper.section import Claim, Effort, Section

SEEDS, QUICK_SEEDS = (1, 2), (1,)
QUICK_S = 12.0
WEIGHTLESS = "odometry.white_share=1e-12"  # the wheels still predict, hold open directions and deskew
NO_LOOPS = "loops.use=false"
NO_SECOND_PASS = ("refine.passes=0", "refine.localise=false")


def setup_of(loops: bool, wheels: bool, second_pass: bool) -> Setup:
    """Point-to-line on compensated scans, with some of the graph's parts."""
    settings: list[str] = []
    if not loops:
        settings.append(NO_LOOPS)
    if not wheels:
        settings.append(WEIGHTLESS)
    if not second_pass:
        settings += NO_SECOND_PASS
    parts = ((loops, "loops"), (wheels, "wheels"), (second_pass, "second pass"))
    return Setup(" + ".join(name for used, name in parts if used) or "front end alone", (), tuple(settings))


def run(effort: Effort) -> Section:
    seeds = QUICK_SEEDS if effort.quick else SEEDS
    corners = [(False, False, False), (True, True, True)]
    setups = [setup_of(*parts) for parts in (corners if effort.quick else product((False, True), repeat=3))]
    worlds = (SQUARE,) if effort.quick else (SQUARE, H)
    tasks = [
        Task(world, seed, setup, QUICK_S if effort.quick else None)
        for world in worlds
        for setup in setups
        for seed in seeds
    ]
    mapped = map_all(tasks, effort.jobs)
    groups = {
        (world, setup.name): [m for m in mapped if (m.task.world, m.task.setup) == (world, setup)]
        for world in worlds
        for setup in setups
    }
    alone, full = setups[0].name, setups[-1].name
    claims = [_claim(world, groups[world, alone], groups[world, full]) for world in worlds]
    body = [
        "Point-to-line ICP on compensated scans against the recent map, then the parts of the graph one by one. "
        "Switched off, *loops*: `loops.use=false`; *wheels*: `odometry.white_share=1e-12`, wheel factors without weight, while the "
        "wheels still predict, compensate and hold what a scan leaves open; *second pass*: `refine.passes=0`, "
        f"`refine.localise=false`. Root mean square over {len(seeds)} log{'s' if len(seeds) > 1 else ''} each; "
        "in brackets the worst log's.",
        _table(groups),
    ]
    measured = {
        f"{world}: {name}": [
            {"seed": m.task.seed, "loops": m.loops, "cpu_s": m.cpu_s, **vars(m.error)} for m in group
        ]
        for (world, name), group in groups.items()
    }
    return Section("The graph on top", "\n\n".join(body), claims, measured)


def _table(groups: dict[tuple[str, str], list[Mapped]]) -> str:
    lines = [
        "| world | parts | ATE, m | ATE, deg | walls, mm | walls, drift left out, mm | loops | CPU s |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for (world, name), group in groups.items():
        worst = max(m.error.rms_m for m in group)
        cells = [
            SPOKEN[world],
            name,
            f"{mean_error(group, 'ate_m'):.3f}",
            f"{mean_error(group, 'ate_deg'):.2f}",
            f"{1e3 * mean_error(group, 'rms_m'):.0f} ({1e3 * worst:.0f})",
            f"{1e3 * mean_error(group, 'local_rms_m'):.1f}",
            f"{np.mean([m.loops for m in group]):.0f}",
            f"{np.mean([m.cpu_s for m in group]):.1f}",
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def _claim(world: str, alone: list[Mapped], full: list[Mapped]) -> Claim:
    before, after = mean_error(alone, "ate_m"), mean_error(full, "ate_m")
    return Claim(
        f"Stochastic methods can improve the estimate (the paper's future work), {SPOKEN[world]}",
        f"ATE {before:.3f} m without the graph's parts, {after:.3f} m with all",
        after < before,
        "loops tie the ends together where places are seen again, and the second pass spreads that over all scans"
        if after < before
        else "the second pass gains where loops hold the ends together, and loses where few of them do",
    )
