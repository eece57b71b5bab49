"""Rays through a grid: every cell that a beam crosses, once, and nothing else."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mfslam import se2
from mfslam.kernels.raytrace import (
    FREE,
    HIT,
    SILENT,
    bridge_hits,
    drop_mixed,
    limit_range,
    place_beams,
    stop_short,
    trace_beams,
)

COLS, ROWS, CELL = 60, 50, 0.25
ORIGIN = np.array([-3.0, 2.0])


def trace(start, end, stop=None, kind=HIT):
    """Counts of one beam between positions in cells (x, y)."""
    as_m = [ORIGIN + CELL * np.asarray(p, dtype=float) for p in (start, end if stop is None else stop, end)]
    counts = [np.zeros((ROWS, COLS), np.uint16) for _ in range(3)]
    starts, stops, ends = (p[None] for p in as_m)
    trace_beams(starts, stops, ends, np.array([kind], np.int8), ORIGIN, CELL, *counts)
    return counts


def cells_of(counts) -> set[tuple[int, int]]:
    return {(int(x), int(y)) for y, x in np.argwhere(counts)}


positions = st.tuples(st.floats(1.01, COLS - 1.01), st.floats(1.01, ROWS - 1.01))


@given(positions, positions)
@settings(max_examples=300, deadline=None)
def test_a_beam_counts_each_cell_it_crosses_once(start, end):
    hits, passes, nears = trace(start, end)
    first, last = np.floor(start).astype(int), np.floor(end).astype(int)
    assert hits[last[1], last[0]] == 1 and hits.sum() == 1
    assert nears.sum() == 0 or tuple(np.argwhere(nears)[0][::-1]) != tuple(first)
    crossed = cells_of(passes)
    steps = int(np.abs(last - first).sum())
    assert int(passes.max(initial=0)) <= 1 and len(crossed) == steps
    # every cell lies on the straight line between the two
    along = np.subtract(end, start)
    for x, y in crossed:
        centre = np.array([x + 0.5, y + 0.5]) - start
        off = abs(along[0] * centre[1] - along[1] * centre[0]) / np.hypot(*along)
        assert off <= np.sqrt(0.5) + 1e-6
    # and they form a chain from the first cell to the last
    if steps:
        assert tuple(first) in crossed
        chain = sorted(
            [*crossed, tuple(last.tolist())], key=lambda c: abs(c[0] - first[0]) + abs(c[1] - first[1])
        )
        gaps = [abs(a[0] - b[0]) + abs(a[1] - b[1]) for a, b in itertools.pairwise(chain)]
        assert set(gaps) == {1}


@given(positions, positions, st.floats(0.0, 1.0))
@settings(max_examples=200, deadline=None)
def test_short_of_its_stop_passes_beyond_it_near_passes(start, end, share):
    stop = np.asarray(start) + share * np.subtract(end, start)
    hits, passes, nears = trace(start, end, stop)
    whole = trace(start, end)[1]
    assert np.array_equal(passes + nears, whole)
    last, at_stop = np.floor(end).astype(int), np.floor(stop).astype(int)
    assert hits[last[1], last[0]] == 1
    if tuple(at_stop) != tuple(last):
        far = set(cells_of(nears))
        assert len(far) == np.abs(last - at_stop).sum() - 1


@pytest.mark.parametrize(
    ("end", "crossed"),
    [
        ((4.5, 1.5), {(1, 1), (2, 1), (3, 1)}),
        ((1.5, 4.5), {(1, 1), (1, 2), (1, 3)}),
        ((1.7, 1.2), set()),
        ((3.5, 2.0), {(1, 1), (2, 1), (3, 1)}),
    ],
)
def test_cells_by_hand(end, crossed):
    hits, passes, _ = trace((1.5, 1.5), end)
    assert cells_of(passes) == crossed
    assert cells_of(hits) == {(int(end[0]), int(end[1]))}


def test_a_beam_without_return_frees_its_last_cell_and_a_silent_one_nothing():
    hits, passes, _ = trace((1.5, 1.5), (4.5, 1.5), kind=FREE)
    assert cells_of(passes) == {(1, 1), (2, 1), (3, 1), (4, 1)} and hits.sum() == 0
    assert all(counts.sum() == 0 for counts in trace((1.5, 1.5), (4.5, 1.5), kind=SILENT))


def test_counts_stop_at_their_limit():
    n = 70_000
    start, end = ORIGIN + CELL * np.array([1.5, 1.5]), ORIGIN + CELL * np.array([3.5, 1.5])
    counts = [np.zeros((ROWS, COLS), np.uint16) for _ in range(3)]
    ends = np.tile(end, (n, 1))
    trace_beams(np.tile(start, (n, 1)), ends, ends, np.full(n, HIT, np.int8), ORIGIN, CELL, *counts)
    assert counts[0][1, 3] == 65535 and counts[1][1, 2] == 65535


poses = st.tuples(st.floats(-50, 50), st.floats(-50, 50), st.floats(-3, 3)).map(np.array)


@given(poses, poses, st.tuples(st.floats(-5, 5), st.floats(-1, 1), st.floats(-6, 6)).map(np.array))
@settings(max_examples=50, deadline=None)
def test_beams_start_and_end_where_se2_says(pose, mount, twist):
    """Eqs. 16-18 by se2 alone: world_T_body exp(twist t) body_T_laser (r cos a, r sin a)."""
    angles, times = np.linspace(-2.0, 2.0, 7), np.linspace(-0.05, 0.1, 7)
    ranges = np.array([[1.0, 2.0, np.inf, np.nan, 0.05, 29.0, 31.0]], np.float32)
    starts, ends, kinds = np.empty((1, 7, 2)), np.empty((1, 7, 2)), np.empty((1, 7), np.int8)
    place_beams(
        ranges,
        pose[None],
        np.append(twist, np.zeros(3))[None],
        angles,
        times,
        mount,
        (0.1, 30.0, 4.0),
        starts,
        ends,
        kinds,
    )
    world_T_laser = se2.compose(se2.compose(pose, se2.exp(twist * times[:, None])), mount)
    np.testing.assert_allclose(starts[0], world_T_laser[:, :2], atol=1e-9)
    assert kinds[0].tolist() == [HIT, HIT, FREE, SILENT, SILENT, HIT, FREE]
    reach = np.where(kinds[0] == FREE, 4.0, np.where(kinds[0] == HIT, ranges[0], 0.0))
    rays = np.stack([reach * np.cos(angles), reach * np.sin(angles)], axis=-1)
    expected = se2.transform(world_T_laser, rays[:, None, :])[:, 0]
    np.testing.assert_allclose(ends[0], expected, atol=1e-9)


def test_without_the_setting_a_beam_without_return_says_nothing():
    ranges = np.full((1, 2), np.inf, np.float32)
    starts, ends, kinds = np.empty((1, 2, 2)), np.empty((1, 2, 2)), np.empty((1, 2), np.int8)
    still = np.zeros((1, 3))
    place_beams(
        ranges,
        still,
        np.zeros((1, 6)),
        np.zeros(2),
        np.zeros(2),
        np.zeros(3),
        (0.1, 30.0, 0.0),
        starts,
        ends,
        kinds,
    )
    assert kinds.tolist() == [[SILENT, SILENT]]


def test_far_hits_are_cut_to_free_space_and_bounds_hold_the_rest():
    starts = np.zeros((1, 3, 2))
    ends = np.array([[[3.0, 4.0], [30.0, 40.0], [900.0, 0.0]]])
    kinds = np.array([[HIT, HIT, SILENT]], np.int8)
    bounds = np.array([np.inf, np.inf, -np.inf, -np.inf])
    limit_range(starts, ends, kinds, 10.0, bounds)
    np.testing.assert_allclose(ends[0, :2], [[3.0, 4.0], [6.0, 8.0]])
    assert kinds.tolist() == [[HIT, FREE, SILENT]]
    np.testing.assert_allclose(bounds, [0.0, 0.0, 6.0, 8.0])


@pytest.mark.parametrize("incidence_deg", [90.0, 45.0, 20.0, 8.0])
def test_beams_stop_two_sigmas_off_the_wall_they_meet(incidence_deg):
    """Beams onto the wall y = 2: each stops 2 sigma short of it, measured across the wall."""
    sigma, wall = 0.01, 2.0
    angles = np.radians(incidence_deg) + np.radians(0.5) * np.arange(-3, 4)
    ends = (wall / np.sin(angles))[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    starts, stops = np.zeros((1, 7, 2)), np.empty((1, 7, 2))
    stop_short(starts, ends[None], np.full((1, 7), HIT, np.int8), sigma, stops)
    np.testing.assert_allclose(stops[0, :, 1], wall - 2.0 * sigma, atol=1e-9)


def test_a_beam_without_neighbours_stops_two_sigmas_short():
    starts, stops = np.zeros((1, 3, 2)), np.empty((1, 3, 2))
    ends = np.array([[[1.0, 0.0], [3.0, 0.0], [1.0, 0.0]]])
    stop_short(starts, ends, np.array([[SILENT, HIT, FREE]], np.int8), 0.05, stops)
    np.testing.assert_allclose(stops[0, 1:], [[2.9, 0.0], [1.0, 0.0]])


def mixed(ranges, sigma=0.01, step=0.01):
    """Kinds and lengths of beams after mixed hits were dropped."""
    ranges = np.array([ranges], np.float32)
    angles = step * np.arange(ranges.shape[1])
    starts = np.zeros((*ranges.shape, 2))
    ends = np.nan_to_num(ranges)[..., None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    kinds = np.where(np.isfinite(ranges), HIT, SILENT).astype(np.int8)
    drop_mixed(ranges, starts, ends, kinds, sigma, step)
    return kinds[0].tolist(), np.hypot(*ends[0].T)


def test_a_range_between_two_surfaces_is_free_space_up_to_the_nearer():
    kinds, length = mixed([2.0, 2.0, 2.0, 3.1, 5.0, 5.0, 5.0])
    assert kinds == [HIT, HIT, HIT, FREE, HIT, HIT, HIT]
    assert length[3] == pytest.approx(2.0 - 3 * 0.01, abs=1e-5)


def test_surfaces_seen_aslant_poles_and_gaps_are_not_mixed():
    along_a_wall = (1.0 / np.sin(0.05 + 0.01 * np.arange(8))[::-1]).tolist()
    assert mixed(along_a_wall)[0] == [HIT] * 8
    assert mixed([5.0, 5.0, 2.0, 5.0, 5.0])[0] == [HIT] * 5, "a pole"
    assert mixed([2.0, 2.0, 6.0, 2.0, 2.0])[0] == [HIT] * 5, "a crack"
    assert mixed([2.0, 2.0, 4.0, np.nan, 7.0, 7.0])[0][2] == HIT, "the neighbour says nothing"


def test_hits_of_one_surface_have_wall_between_them():
    hits = np.zeros((ROWS, COLS), np.uint16)
    ends = ORIGIN + CELL * np.array([[[5.5, 4.5], [9.5, 4.5], [9.5, 20.5], [30.5, 20.5]]])
    facings = np.array([[6, 6, 6, 6]], np.int8)  # towards -y
    kinds = np.full((1, 4), HIT, np.int8)
    bridge_hits(ends, kinds, facings, 8, ORIGIN, CELL, 2.0, hits)
    assert cells_of(hits) == {(6, 4), (7, 4), (8, 4)}, "neither along the view nor over a wide gap"
    kinds[0, 1] = FREE
    hits[:] = 0
    bridge_hits(ends, kinds, facings, 8, ORIGIN, CELL, 2.0, hits)
    assert hits.sum() == 0
