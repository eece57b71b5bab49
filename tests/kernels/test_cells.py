"""The hash grid: nearest neighbours as by brute force, surfaces as drawn."""

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from mfslam.kernels import cells
from mfslam.kernels.partners import find_partners, nothing_known

CELL_M = 0.25
NO_NORMAL = (0.0, 0.0)


def nearest(table, x, y, normal=NO_NORMAL, radius=0.5):
    partner, seen = nothing_known(1)
    find_partners(*table, CELL_M, np.array([[x, y, *normal]]), radius, 0.7, partner, seen)
    return int(partner[0])


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    st.integers(0, 100_000),
    st.integers(0, 200),
    st.floats(0.01, 1.5),
    st.sampled_from([(0.0, 0.0), (-1e4, 3e4), (1e6, -1e6)]),
)
def test_nearest_is_the_nearest(seed, count, radius, center):
    """Also with negative cells, far from the origin and with an empty table."""
    rng = np.random.default_rng(seed)
    rows = np.zeros((count, 4))
    rows[:, :2] = center + rng.uniform(-2.0, 2.0, (count, 2))
    table = cells.build_cells(rows, CELL_M)
    assert sorted(map(tuple, table[1])) == sorted(map(tuple, rows)), "no row is lost"
    for x, y in center + rng.uniform(-2.5, 2.5, (20, 2)):
        found = nearest(table, x, y, radius=radius)
        distances = np.hypot(table[1][:, 0] - x, table[1][:, 1] - y)
        best = distances.min(initial=math.inf)
        if best >= radius:
            assert found == -1
        else:
            assert distances[found] == best


@settings(max_examples=40, deadline=None, derandomize=True)
@given(st.integers(0, 100_000), st.floats(1e-5, 0.3), st.floats(0.05, 0.6))
def test_partners_that_are_kept_are_those_of_a_new_search(seed, stride, radius):
    """Points that wander over a table while the radius shrinks: what is remembered tells no lies."""
    rng = np.random.default_rng(seed)
    rows = np.zeros((150, 4))
    rows[:, :2] = rng.uniform(-1.0, 1.0, (150, 2))
    table = cells.build_cells(rows, CELL_M)
    placed = np.zeros((40, 4))
    placed[:, :2] = rng.uniform(-1.5, 1.5, (40, 2))
    partner, seen = nothing_known(40)
    for _ in range(8):
        find_partners(*table, CELL_M, placed, radius, 0.7, partner, seen)
        distances = np.hypot(*(table[1][None, :, :2] - placed[:, None, :2]).T)
        best, kept = distances.min(axis=0), partner >= 0
        assert kept[best < radius].all(), "whoever has a partner within the radius has one"
        assert (distances[partner[kept], np.flatnonzero(kept)] == best[kept]).all()
        placed[:, :2] += rng.uniform(-stride, stride, (40, 2))
        radius *= 0.8


def test_partners_look_the_same_way():
    """The two faces of a thin wall are no partners; a point without a normal is anyone's."""
    faces = np.array([[1.00, 0.0, 1.0, 0.0], [1.10, 0.0, -1.0, 0.0], [1.30, 0.0, 0.0, 0.0]])
    table = cells.build_cells(faces, CELL_M)

    def partner(x, normal):
        return tuple(table[1][nearest(table, x, 0.0, normal)])

    assert partner(1.02, (-1.0, 0.0)) == tuple(faces[1])
    assert partner(1.08, (1.0, 0.0)) == tuple(faces[0])
    assert partner(1.08, (0.0, 1.0)) == tuple(faces[2])
    assert partner(1.08, NO_NORMAL) == tuple(faces[1])


def test_a_smoothed_wall_is_thin_and_evenly_sampled():
    rng = np.random.default_rng(5)
    raw = np.zeros((4000, 4))
    raw[:, 0] = rng.uniform(0.0, 5.0, 4000)
    raw[:, 1] = rng.normal(1.0, 0.02, 4000)
    raw[:, 3] = -1.0
    surface = cells.smooth_surface(cells.build_cells(raw, CELL_M), CELL_M, 0.1, 0.04)
    assert np.std(surface[:, 1]) < 0.004, "the noise of a single range is averaged out"
    assert abs(np.mean(surface[:, 1]) - 1.0) < 0.001
    np.testing.assert_allclose(surface[:, 2:], np.tile([0.0, -1.0], (len(surface), 1)), atol=1e-12)
    assert 5.0 / 0.08 < len(surface) < 5.0 / 0.02
    assert np.max(np.diff(np.sort(surface[:, 0]))) < 0.1, "no gap opens"


def test_smoothing_keeps_the_faces_of_a_thin_wall_apart():
    x = np.repeat(np.arange(0.0, 2.0, 0.01), 2)
    raw = np.stack([x, np.tile([0.0, 0.06], 200), np.zeros(400), np.tile([-1.0, 1.0], 200)], axis=-1)
    surface = cells.smooth_surface(cells.build_cells(raw, CELL_M), CELL_M, 0.1, 0.04)
    np.testing.assert_allclose(surface[surface[:, 3] < 0.0, 1], 0.0, atol=1e-12)
    np.testing.assert_allclose(surface[surface[:, 3] > 0.0, 1], 0.06, atol=1e-12)
