"""Where walls end: seen between two beams, and the only thing that tells the way along a corridor of flat walls."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mfslam import ends, se2
from mfslam.config import Config, DeskewConfig
from mfslam.frontend import Frontend
from mfslam.step_records import PredictedMotion
from tests.rooms import CORRIDOR, NO_PILLARS, laser, moving_scan

STILL = np.zeros(3)
MODEL = laser(range_max_m=4.0)
AHEAD = np.array([1.0, 0.0])
DOORS_M = (
    2.0,
    5.0,
    8.0,
    11.0,
)  # 1 m wide, on both sides of a corridor of 2 m; nothing stands behind them in range
JAMBS_M = np.array([0.0, *(x for door in DOORS_M for x in (door, door + 1.0)), 60.0])
DOORED = np.array([[a, y, b, y] for y in (-1.0, 1.0) for a, b in JAMBS_M.reshape(-1, 2)])


def seen(x_m, twist=STILL, model=MODEL, world=DOORED):
    pose = np.array([x_m, 0.1, 0.05])
    scan = moving_scan(world, NO_PILLARS, pose, twist, model)
    return scan, ends.placed(ends.wall_ends(scan, twist, DeskewConfig()), pose)


@pytest.mark.parametrize("twist", [STILL, np.array([2.0, 0.0, 0.5])])
def test_jambs_are_seen_where_they_are(twist):
    model = laser(range_max_m=4.0, turn_s=0.1)
    offset_s = 0.5 * model.offsets_s[-1]
    pose = np.array([3.8, 0.1, 0.05])
    scan = moving_scan(DOORED, NO_PILLARS, pose, twist, model)
    found = ends.placed(
        ends.wall_ends(scan, twist, DeskewConfig()), se2.compose(pose, se2.exp(twist * offset_s))
    )
    jambs = JAMBS_M[(JAMBS_M > 1.5) & (JAMBS_M < 6.5)]
    expected = {(x, y) for x in jambs.tolist() for y in (-1.0, 1.0)}
    off_m = np.hypot(*(found[:, None, :2] - np.array(sorted(expected))).transpose(2, 0, 1))
    assert off_m.min(axis=1).max() < 0.04 and len(set(off_m.argmin(axis=1))) == len(expected)
    # out of the wall is into the door
    x, out = found[:, 0], found[:, 2]
    np.testing.assert_allclose(out, np.where(np.isin(np.round(x), DOORS_M), 1.0, -1.0), atol=0.02)


def test_nothing_ends_along_a_bare_wall():
    """Neither where the range does, nor at beams that are lost, nor beside what stands before it."""
    scan, found = seen(0.0, world=CORRIDOR)
    assert len(found) == 0
    ranges_m = scan.ranges_m.copy()
    ranges_m[::7] = np.nan
    assert len(ends.wall_ends(dataclasses.replace(scan, ranges_m=ranges_m), STILL, DeskewConfig())) == 0
    post = moving_scan(CORRIDOR, np.array([[1.0, 0.5, 0.1]]), np.zeros(3), STILL, MODEL)
    assert len(ends.wall_ends(post, STILL, DeskewConfig())) == 0


def test_a_sensor_may_lose_what_is_out_of_its_range():
    scan, known = seen(3.8)
    lost = dataclasses.replace(scan, ranges_m=np.where(np.isinf(scan.ranges_m), np.nan, scan.ranges_m))
    assert len(ends.wall_ends(lost, STILL, DeskewConfig())) == len(known) > 0


def test_a_shift_along_the_wall_is_what_brings_ends_onto_ends():
    known, now = seen(3.8)[1], seen(4.1)[1]
    now[:, 0] -= 0.12
    shift_m, sigma_m = ends.shift_along(ends.along(now, AHEAD), ends.along(known, AHEAD), AHEAD, 0.3)
    assert abs(shift_m - 0.12) < 3.0 * sigma_m < 0.06


def test_ends_that_fit_as_well_elsewhere_or_alone_tell_nothing():
    known, now = seen(3.8)[1], seen(4.1)[1]
    assert ends.shift_along(now[:1], known, AHEAD, 0.3) is None
    # doors are 3 m apart: one of them, halfway, may be this or that
    one = now[(now[:, 0] > 4.5) & (now[:, 0] < 6.5)] - np.array([1.5, 0.0, 0.0, 0.0, 0.0])
    assert ends.shift_along(one, known, AHEAD, 2.0) is None
    assert ends.shift_along(one, known, AHEAD, 1.6) is None
    assert ends.shift_along(now - np.array([0.1, 0.0, 0.0, 0.0, 0.0]), known, AHEAD, 2.0) is not None


def test_without_wheels_doors_tell_the_way_along_a_corridor():
    frontend, steps = Frontend(Config()), []
    step = np.array([0.1, 0.0, 0.0])
    for n in range(60):
        scan = moving_scan(DOORED, NO_PILLARS, np.array([1.0 + 0.1 * n, 0.0, 0.0]), 10.0 * step, MODEL)
        twist = frontend.last_step / 0.1
        steps.append(frontend.process(n, scan, PredictedMotion(twist, 0.1 if n else 0.0)))
    assert abs(steps[-1].local_T_body[0] - 5.9) < 0.05
    assert any(s.match is not None and s.match.by_ends is not None for s in steps)
