"""Thinning: what is connected stays connected, and a blurred wall becomes its ridge."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import ndimage

from mfslam.kernels.walls import find_flanks, smooth_hits, thin_walls

EIGHT = np.ones((3, 3))


def patches(cells: np.ndarray, structure=None) -> int:
    return ndimage.label(np.pad(cells, 1), structure)[1]


@given(arrays(np.bool_, (12, 14), elements=st.booleans()), st.integers(0, 2**31))
@settings(max_examples=150, deadline=None)
def test_thinning_keeps_what_is_connected_and_what_is_closed(occupied, seed):
    cells = np.argwhere(occupied)
    chosen = cells[np.random.default_rng(seed).permutation(len(cells))]
    thin = occupied.copy()
    thin_walls(thin, chosen)
    assert not np.any(thin & ~occupied)
    assert patches(thin, EIGHT) == patches(occupied, EIGHT), "pieces of wall"
    assert patches(~np.pad(thin, 1)) == patches(~np.pad(occupied, 1)), "rooms"


def test_only_the_cells_named_are_cleared():
    block = np.ones((5, 5), np.bool_)
    thin_walls(block, np.array([[0, 2], [4, 2]]))
    assert block.sum() == 23 and not block[0, 2] and not block[4, 2]


@pytest.mark.parametrize("angle_deg", [0.0, 17.0, 45.0, 73.0, 90.0])
def test_a_blurred_wall_becomes_its_ridge(angle_deg):
    """A straight wall through the grid's middle, its hits spread by 1.5 cells (one sigma) across it."""
    rng, size, sigma = np.random.default_rng(3), 80, 1.5
    c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    along, across = rng.uniform(-30, 30, 60_000), rng.normal(0.0, sigma, 60_000)
    cols = (40.3 + c * along - s * across).astype(int)
    rows = (40.6 + s * along + c * across).astype(int)
    hits = np.zeros((size, size), np.uint16)
    np.add.at(hits, (rows, cols), 1)
    occupied = hits >= 10
    cells = np.argwhere(occupied)
    weights = np.exp(-0.5 * (np.arange(-3, 4) / sigma) ** 2)
    density = np.zeros(hits.shape, np.float32)
    smooth_hits(hits, cells, weights, 0, density)
    flank, value = find_flanks(density, 0, cells, 4, 4, 5)
    thin_walls(occupied, cells[flank][np.argsort(value[flank], kind="stable")])
    left = np.argwhere(occupied) + 0.5
    inner = np.abs(c * (left[:, 1] - 40.3) + s * (left[:, 0] - 40.6)) < 28
    off = c * (left[:, 0] - 40.6) - s * (left[:, 1] - 40.3)
    assert np.max(np.abs(off[inner])) < 1.2
    assert patches(occupied, EIGHT) == 1
    # one cell per column (or row, for a steep wall), a corner more here and there
    assert inner.sum() == pytest.approx(56 * max(c, s), rel=0.1)


def test_smoothing_in_a_band_is_smoothing_in_the_whole():
    rng = np.random.default_rng(0)
    hits = rng.integers(0, 5, (30, 20)).astype(np.uint16)
    weights = np.array([0.25, 0.5, 0.25])
    whole, band = np.zeros((30, 20), np.float32), np.zeros((10, 20), np.float32)
    smooth_hits(hits, np.argwhere(hits >= 0), weights, 0, whole)
    in_band = np.argwhere(hits >= 0)
    smooth_hits(hits, in_band[(in_band[:, 0] >= 8) & (in_band[:, 0] < 18)], weights, 8, band)
    np.testing.assert_array_equal(band, whole[8:18])
    np.testing.assert_allclose(
        whole, ndimage.convolve(hits.astype(float), np.outer(weights, weights), mode="constant"), rtol=1e-6
    )
