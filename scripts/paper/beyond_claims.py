"""Beyond the paper: what the section says in the page's table of claims."""

from __future__ import annotations

from collections.abc import Sequence

from paper import beyond_pages as pages
from paper.beyond_conditions import RAMP_S, Condition
from paper.beyond_logs import CONSTANT_TWIST, JOINT_TWIST, LogOutcome
from paper.beyond_pages import Results
from paper.beyond_plan import BASE, Plan
from paper.beyond_runs import (
    CONSTANT,
    CONVENTIONAL,
    ENGINE,
    FRONTIER,
    JOINT,
    LOST_DEG,
    MOTION_FREE,
    WITH_WHEELS,
    Method,
)
from paper.section import Claim


def claims(results: Results, logs: Sequence[LogOutcome], plan: Plan) -> list[Claim]:
    """All of them; those of recorded logs where there are any."""
    found = [*frontier_claims(results, plan), delay_claim(results, plan), ramps_claim(results, plan)]
    return [*found, logs_claim(logs)] if logs else found


def frontier_claims(results: Results, plan: Plan) -> list[Claim]:
    """Where each way to map is of use, over the drives of the grids."""
    grid = plan.grid()
    healthy = list(dict.fromkeys(c for row in (*plan.laps(), *plan.spins()) for c in row))
    spoilt = [c for c in grid if c not in healthy]
    mapped = {m: grid if m in WITH_WHEELS else healthy for m in FRONTIER}
    usable = {
        m.name: {c for c in drives if pages.is_usable(pages.outcome(results, c, m))}
        for m, drives in mapped.items()
    }

    def share(method: Method, among: list[Condition]) -> str:
        return f"{len(usable[method.name] & set(among))} of {len(among)}"

    def lost(method: Method, among: list[Condition]) -> str:
        return pages.named([c for c in among if c not in usable[method.name]])

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
            f"of use in {share(ENGINE, grid)} drives, motion-free ICP alone in {share(MOTION_FREE, grid)}",
            usable[ENGINE.name] > usable[MOTION_FREE.name],
            f"not of use: {lost(ENGINE, grid)}",
        ),
        Claim(
            "Without any wheels, pose and twist estimated together map whatever a constant twist maps, and more",
            f"of use in {share(JOINT, healthy)} drives, constant twist in {share(CONSTANT, healthy)}",
            usable[JOINT.name] > usable[CONSTANT.name],
            f"not of use: {lost(JOINT, healthy)}; constant twist: {lost(CONSTANT, healthy)}",
        ),
    ]


def delay_claim(results: Results, plan: Plan) -> Claim:
    """A late laser whose delay is told, and one whose delay is not."""
    latest, told, none = plan.late(False)[-1], plan.late(True)[-1], plan.late(False)[0]
    drives = {"told": results[told], "not told": results[latest], "without any": results[none]}

    def errors(method: Method) -> str:
        return ", ".join(f"{pages.in_cm(m.of(method).ate_m)} cm {name}" for name, m in drives.items())

    def is_harmless(method: Method) -> bool:
        late, first = results[told].of(method), results[none].of(method)
        return late.ate_m <= 1.5 * first.ate_m and late.ate_deg <= 1.5 * first.ate_deg

    return Claim(
        "A transport delay spoils the map of motion-free ICP alone, and does no harm once it is known",
        f"{1000 * latest.delay_s:g} ms at {latest.yaw_rate_rad_s:g} rad/s: ATE {errors(MOTION_FREE)}; "
        f"whole engine {errors(ENGINE)}",
        not pages.is_usable(results[latest].of(MOTION_FREE))
        and all(is_harmless(m) for m in (MOTION_FREE, ENGINE)),
        "no harm: within 1.5 times the errors without delay, in position and heading; the engine does not find it out",
    )


def ramps_claim(results: Results, plan: Plan) -> Claim:
    """Turns that begin within a few scans, without wheels."""
    ramps, methods = plan.ramps(), (JOINT, CONSTANT, ENGINE)
    worst = {m: [pages.outcome(results, c, m).worst_step_deg for c in ramps] for m in methods}
    at = [f"{c.yaw_rate_rad_s:g} rad/s at {c.rate_hz:g} Hz" for c in ramps]
    by_drive = zip(at, *worst.values(), strict=True)
    change_rad_s = max(c.yaw_rate_rad_s / RAMP_S / c.rate_hz for c in ramps)
    return Claim(
        "Without any wheels, a robot that begins to turn within a few scans is followed: no step off by more than "
        f"{LOST_DEG:g} deg",
        f"worst step {max(worst[JOINT]):.1f} deg; with a constant twist {max(worst[CONSTANT]):.1f} deg, with wheels "
        f"{max(worst[ENGINE]):.1f} deg",
        max(worst[JOINT]) <= LOST_DEG,
        "joint, constant, wheels: "
        + "; ".join(f"{name}: {a:.1f}, {b:.1f}, {c:.1f} deg" for name, a, b, c in by_drive)
        + f". The rate changes by up to {change_rad_s:.1f} rad/s within a scan, which no one twist can tell",
    )


def logs_claim(logs: Sequence[LogOutcome]) -> Claim:
    """Recorded logs with odometry removed: crispness of their maps, in both ways."""
    cells = {(o.log, o.variant): o.cells for o in logs}
    names = list(dict.fromkeys(o.log for o in logs))
    relations = {(o.log, o.variant): o.relations_m for o in logs if o.relations_m is not None}
    known = list(dict.fromkeys(log for log, _ in relations))
    gains = {n: 1.0 - cells[n, JOINT_TWIST] / cells[n, CONSTANT_TWIST] for n in names}
    return Claim(
        "On recorded logs with their odometry removed, pose and twist estimated together make a crisper map than a "
        "constant twist",
        f"on {sum(gain > 0.0 for gain in gains.values())} of {len(names)} logs",
        min(gains.values()) > 0.0,
        "2 cm cells: "
        + "; ".join(f"{name} {-100.0 * gain:+.1f} %" for name, gain in gains.items())
        + "".join(
            f"; relations of {n}: {relations[n, CONSTANT_TWIST]:.4f} to {relations[n, JOINT_TWIST]:.4f} m"
            for n in known
        ),
    )
