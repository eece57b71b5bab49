"""Beyond the paper: what the section says in the page's table of claims."""

from __future__ import annotations

from collections.abc import Sequence

from paper import beyond_pages as pages
from paper.beyond_conditions import Condition
from paper.beyond_logs import CONSTANT_TWIST, JOINT_TWIST, LogOutcome
from paper.beyond_pages import Results
from paper.beyond_plan import BASE, Plan
from paper.beyond_runs import CONSTANT, CONVENTIONAL, ENGINE, FRONTIER, JOINT, LOST_DEG, MOTION_FREE, Method
from paper.section import Claim


def claims(results: Results, logs: Sequence[LogOutcome], plan: Plan) -> list[Claim]:
    """All of them; those of recorded logs where there are any."""
    found = [*frontier_claims(results, plan), delay_claim(results, plan), ramps_claim(results, plan)]
    return [*found, logs_claim(logs)] if logs else found


def frontier_claims(results: Results, plan: Plan) -> list[Claim]:
    """Where each way to map is of use, over the drives of the grids."""
    grid = plan.grid()
    usable = {m.name: {c for c in grid if pages.is_usable(pages.outcome(results, c, m))} for m in FRONTIER}
    healthy = [c for c in grid if c in {d for row in (*plan.laps(), *plan.spins()) for d in row}]
    spoilt = [c for c in grid if c not in healthy]

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
    latest = plan.late(False)[-1]
    told, first = results[plan.late(True)[-1]].of(ENGINE), results[plan.late(False)[0]].of(ENGINE)
    late = results[latest].of(ENGINE)
    return Claim(
        "A transport delay does no harm once it is known",
        f"{1000 * latest.delay_s:g} ms at 2 rad/s: ATE {pages.in_cm(told.ate_m)} cm {told.ate_deg:.2f} deg told, "
        f"{pages.in_cm(late.ate_m)} cm {late.ate_deg:.2f} deg not told, "
        f"{pages.in_cm(first.ate_m)} cm {first.ate_deg:.2f} deg without any",
        told.ate_m <= 1.5 * first.ate_m < late.ate_m and told.ate_deg <= 1.5 * first.ate_deg < late.ate_deg,
        "told: within 1.5 times the errors without delay, which untold it exceeds; the engine does not find it out",
    )


def ramps_claim(results: Results, plan: Plan) -> Claim:
    """Turns that begin within a few scans, without wheels."""
    ramps = plan.ramps()
    worst = {m: [pages.outcome(results, c, m).worst_step_deg for c in ramps] for m in (CONSTANT, JOINT)}
    at = [f"{c.yaw_rate_rad_s:g} rad/s at {c.rate_hz:g} Hz" for c in ramps]
    by_drive = zip(at, worst[JOINT], worst[CONSTANT], strict=True)
    return Claim(
        "Without any wheels, a robot that begins to turn within a few scans is followed: no step off by more than "
        f"{LOST_DEG:g} deg",
        f"worst step {max(worst[JOINT]):.1f} deg; with a constant twist {max(worst[CONSTANT]):.1f} deg",
        max(worst[JOINT]) <= LOST_DEG,
        "; ".join(f"{name}: {joint:.1f}, {constant:.1f} deg" for name, joint, constant in by_drive),
    )


def logs_claim(logs: Sequence[LogOutcome]) -> Claim:
    """Recorded logs with odometry removed: crispness of their maps, in both ways."""
    cells = {(o.log, o.variant): o.cells for o in logs}
    names = list(dict.fromkeys(o.log for o in logs))
    gains = {n: 1.0 - cells[n, JOINT_TWIST] / cells[n, CONSTANT_TWIST] for n in names}
    return Claim(
        "On recorded logs with their odometry removed, pose and twist estimated together make a crisper map than a "
        "constant twist",
        f"on {sum(gain > 0.0 for gain in gains.values())} of {len(names)} logs",
        min(gains.values()) > 0.0,
        "2 cm cells: " + "; ".join(f"{name} {-100.0 * gain:+.1f} %" for name, gain in gains.items()),
    )
