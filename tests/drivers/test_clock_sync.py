from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.clock_sync import ClockSync, Unwrapped
from drivers.host_clock import HostClock


@given(start=st.integers(0, (1 << 24) - 1), steps=st.lists(st.integers(0, (1 << 23) - 1), max_size=30))
def test_a_counter_goes_on_where_it_wraps(start: int, steps: list[int]) -> None:
    unwrapped, total = Unwrapped(24), start
    assert unwrapped(start) == start
    for step in steps:
        total += step
        assert unwrapped(total % (1 << 24)) == total


@given(offset_s=st.floats(-1e4, 1e4), seed=st.integers(0, 100))
def test_exchanges_find_the_offset_closer_than_a_tick(offset_s: float, seed: int) -> None:
    rng, clock = np.random.default_rng(seed), ClockSync(1e-3)
    for host_s in np.cumsum(rng.uniform(0.002, 0.005, 40)):
        device_s = np.floor((host_s - offset_s) * 1e3) * 1e-3
        clock.exchange(host_s - rng.uniform(0, 2e-3), device_s, host_s + rng.uniform(0, 2e-3))
    assert clock.host_s(5.0) == pytest.approx(5.0 + offset_s, abs=5e-4)
    assert clock.uncertainty_s is not None and clock.uncertainty_s < 6e-4


def test_drift_is_learned_from_arrivals_and_delays_do_not_bend_it() -> None:
    rng, clock = np.random.default_rng(1), ClockSync(1e-3)
    drift, offset_s = 80e-6, 12.0

    def device(host_s: float) -> float:
        return (host_s - offset_s) * (1.0 + drift)

    for host_s in np.arange(20.0, 20.2, 0.013):
        clock.exchange(host_s - 1e-3, np.floor(device(host_s) * 1e3) * 1e-3, host_s + 1e-3)
    for k in range(6000):
        sensed_s = 21.0 + 0.1 * k + rng.uniform(0, 1e-3)
        late_s = 0.08 + rng.exponential(2e-3) + (2.0 if k % 700 > 680 else 0.0)  # stalls of 2 s
        assert clock.arrival(np.floor(device(sensed_s) * 1e3) * 1e-3, sensed_s + late_s)
    at_s = 621.0
    assert clock.host_s(device(at_s)) == pytest.approx(at_s, abs=1.5e-3)  # without drift: 48 ms
    assert -clock.drift == pytest.approx(drift, abs=5e-6)


def test_arrivals_alone_tell_the_time_by_the_least_delay() -> None:
    clock = ClockSync(0.0, least_delay_s=0.09)
    for k in range(100):
        assert clock.arrival(0.1 * k, 50.0 + 0.1 * k + 0.09 + 0.001 * (k % 7))
    assert clock.host_s(3.0) == pytest.approx(53.0, abs=1e-6)


@pytest.mark.parametrize("jump_s", [3.0, -100.0])
def test_a_device_clock_that_is_set_anew_is_noticed(jump_s: float) -> None:
    clock = ClockSync()
    for k in range(100):
        clock.arrival(0.1 * k, 0.1 * k + 0.05)
    assert not all(clock.arrival(0.1 * k + jump_s, 0.1 * k + 0.05) for k in range(100, 130))


def test_stamps_do_not_follow_a_wall_clock_that_is_set() -> None:
    clock = HostClock(now_s=10.0, wall_ns=1_700_000_000_000_000_000)
    assert clock.stamp_ns(12.5) == 1_700_000_002_500_000_000
