"""Beyond the paper: which drives are made, and which of them are mapped in which ways."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import product

from paper.beyond_conditions import Condition
from paper.beyond_runs import (
    ENGINE,
    FRONTIER,
    JOINT,
    LADDER,
    MOTION_FREE,
    WITH_WHEELS,
    WITHOUT_WHEELS,
    Method,
    drive_for,
)

BASE = Condition()
SPIN = Condition(drive="spins", yaw_rate_rad_s=2.0)
HARD = {
    "3 m/s, 10 Hz": BASE,
    "6 m/s, 10 Hz": replace(BASE, speed_m_s=6.0),
    "6 m/s, 5 Hz": replace(BASE, speed_m_s=6.0, rate_hz=5.0),
    "4 rad/s, 10 Hz": replace(SPIN, yaw_rate_rad_s=4.0),
    "4 rad/s, 5 Hz": replace(SPIN, yaw_rate_rad_s=4.0, rate_hz=5.0),
    "2 rad/s, stamps 150 ms late": replace(SPIN, delay_s=0.15),
    "3 m/s with 16 m/s2, 10 Hz": Condition(drive="surge", surge_m_s2=16.0),
    "3 m/s, wheels slip 5 cm per root m": replace(BASE, slip_m_per_sqrt_m=0.05),
}


@dataclass(frozen=True)
class Plan:
    """Values of every factor. ``share``: of each drive's length; ``max_scans``: of each recorded log;
    ``max_logs``: so many of them."""

    speeds_m_s: tuple[float, ...] = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
    yaw_rates_rad_s: tuple[float, ...] = (1.0, 2.0, 4.0)
    rates_hz: tuple[float, ...] = (5.0, 10.0, 20.0, 40.0)
    delays_s: tuple[float, ...] = (0.0, 0.02, 0.05, 0.1, 0.15)
    pulses: tuple[int, ...] = (2048, 256, 128, 64, 32)
    slips: tuple[float, ...] = (0.001, 0.01, 0.02, 0.05)
    wheel_errors: tuple[float, ...] = (0.0, 0.02, 0.05, 0.1)
    ramp_rates_rad_s: tuple[float, ...] = (2.0, 4.0)
    ramp_rates_hz: tuple[float, ...] = (5.0, 10.0)
    hard: tuple[str, ...] = tuple(HARD)
    share: float = 1.0
    max_scans: int | None = None
    max_logs: int | None = None

    def lap(self, speed_m_s: float, rate_hz: float) -> Condition:
        return replace(BASE, speed_m_s=speed_m_s, rate_hz=rate_hz, share=self.share)

    def spin(self, yaw_rate_rad_s: float, rate_hz: float) -> Condition:
        return replace(SPIN, yaw_rate_rad_s=yaw_rate_rad_s, rate_hz=rate_hz, share=self.share)

    @property
    def base(self) -> Condition:
        return replace(BASE, share=self.share)

    @property
    def turning(self) -> Condition:
        return replace(SPIN, share=self.share)

    def laps(self) -> list[list[Condition]]:
        """Rows by the laser's rate, columns by speed."""
        return [[self.lap(v, rate) for v in self.speeds_m_s] for rate in self.rates_hz]

    def spins(self) -> list[list[Condition]]:
        """Rows by the laser's rate, columns by yaw rate."""
        return [[self.spin(w, rate) for w in self.yaw_rates_rad_s] for rate in self.rates_hz]

    def slipping_laps(self) -> list[list[Condition]]:
        """Rows by slip, columns by speed."""
        laps = [self.lap(v, BASE.rate_hz) for v in self.speeds_m_s]
        return [[replace(lap, slip_m_per_sqrt_m=slip) for lap in laps] for slip in self.slips]

    def late_spins(self) -> list[list[Condition]]:
        """Rows by a delay that nobody knows of, columns by yaw rate."""
        spins = [self.spin(w, BASE.rate_hz) for w in self.yaw_rates_rad_s]
        return [[replace(spin, delay_s=delay) for spin in spins] for delay in self.delays_s]

    def grid(self) -> list[Condition]:
        """All of them, each once."""
        grids = (self.laps(), self.spins(), self.slipping_laps(), self.late_spins())
        return list(dict.fromkeys(c for rows in grids for row in rows for c in row))

    def late(self, known: bool) -> list[Condition]:
        return [replace(self.turning, delay_s=delay, delay_known=known) for delay in self.delays_s]

    def quantised(self) -> list[Condition]:
        return [replace(self.turning, ticks_per_turn=pulses) for pulses in self.pulses]

    def slipping(self) -> list[Condition]:
        return [replace(self.base, slip_m_per_sqrt_m=slip) for slip in self.slips]

    def too_small(self) -> list[Condition]:
        return [replace(self.base, radius_error=error) for error in self.wheel_errors]

    def too_wide(self) -> list[Condition]:
        return [replace(self.turning, track_error=error) for error in self.wheel_errors]

    def ramps(self) -> list[Condition]:
        """Turns that begin and end within a few scans."""
        rates = product(self.ramp_rates_hz, self.ramp_rates_rad_s)
        return [
            Condition(drive="ramps", yaw_rate_rad_s=w, rate_hz=rate, share=self.share) for rate, w in rates
        ]

    def hard_drives(self) -> dict[str, Condition]:
        return {name: replace(HARD[name], share=self.share) for name in self.hard}

    def drives(self) -> dict[Condition, list[Method]]:
        """Every drive once, with all ways in which it is mapped; the longest first."""
        wanted: dict[Condition, dict[str, Method]] = {}

        def want(conditions: Iterable[Condition], methods: Iterable[Method]) -> None:
            for condition, method in product(conditions, methods):
                wanted.setdefault(condition, {})
                wanted.setdefault(drive_for(condition, method), {})[method.name] = method

        want((c for row in (*self.laps(), *self.spins()) for c in row), FRONTIER)
        want(self.grid(), WITH_WHEELS)
        faults = [*self.quantised(), *self.slipping(), *self.too_small(), *self.too_wide()]
        want((*self.late(False), *self.late(True), *faults), (MOTION_FREE, ENGINE, JOINT))
        want(self.hard_drives().values(), LADDER)
        want(self.ramps(), (ENGINE, *WITHOUT_WHEELS))
        in_order = sorted(wanted, key=lambda c: -c.rate_hz / min(c.speed_m_s, c.yaw_rate_rad_s))
        return {condition: list(wanted[condition].values()) for condition in in_order}


QUICK = Plan(
    speeds_m_s=(6.0,),
    yaw_rates_rad_s=(2.0,),
    rates_hz=(10.0,),
    delays_s=(0.0, 0.15),
    pulses=(32,),
    slips=(0.05,),
    wheel_errors=(0.1,),
    ramp_rates_rad_s=(2.0,),
    ramp_rates_hz=(5.0,),
    hard=("3 m/s, 10 Hz",),
    share=0.25,
    max_scans=60,
    max_logs=1,
)
