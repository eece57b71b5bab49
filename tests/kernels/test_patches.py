"""Free space: crumbs go, slits between beams close, and nothing else changes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import ndimage

from mfslam.kernels.patches import drop_crumbs, fill_slits

NOWHERE = np.zeros((0, 2), np.int64)


@given(arrays(np.bool_, (11, 13), elements=st.booleans()), st.integers(0, 12))
@settings(max_examples=200, deadline=None)
def test_patches_smaller_than_that_go(free, least):
    labels, _ = ndimage.label(free)
    sizes = np.bincount(labels.ravel())
    expected = free & (sizes[labels] >= least)
    drop_crumbs(free, least, 1, NOWHERE)
    np.testing.assert_array_equal(free, expected)


@given(arrays(np.bool_, (11, 13), elements=st.sampled_from([True, True, False])), st.integers(1, 4))
@settings(max_examples=200, deadline=None)
def test_patches_narrower_than_that_go(free, side):
    labels, _ = ndimage.label(free)
    fits = ndimage.binary_erosion(np.pad(free, 4), np.ones((side, side)))[4:-4, 4:-4]
    expected = free & np.isin(labels, labels[ndimage.binary_dilation(fits, np.ones((side, side))) & free])
    # a square that fits nowhere leaves nothing; one that fits keeps the whole of its patch
    expected = free & np.isin(labels, np.unique(labels[fits & free])) if fits.any() else np.zeros_like(free)
    drop_crumbs(free, 1, side, NOWHERE)
    np.testing.assert_array_equal(free, expected)


def test_where_the_robot_stood_is_no_crumb():
    free = np.zeros((6, 9), np.bool_)
    free[2, 1:8] = True
    free[4, 1:8] = True
    drop_crumbs(free, 20, 3, np.array([[4, 5], [0, 0]]))
    assert not free[2].any() and free[4, 1:8].all() and free.sum() == 7


@pytest.mark.parametrize(
    ("row", "filled"),
    [
        ("0??0", "0000"),  # between beams
        ("0????0", "0????0"),  # too wide
        ("0?#", "00#"),  # in front of a wall that was thinned
        ("0??#", "0??#"),
        ("#??#", "#??#"),  # inside a wall
        ("??0??", "??0??"),
        ("0?#??0?0", "00#??000"),
    ],
)
def test_slits_by_hand(row, filled):
    cells = {"0": 0, "?": -1, "#": 100}
    for as_column in (False, True):
        grid = np.full((5, len(row)), -1, np.int8)
        grid[2] = [cells[c] for c in row]
        grid = np.ascontiguousarray(grid.T) if as_column else grid
        expected = grid.copy()
        (expected.T if as_column else expected)[2] = [cells[c] for c in filled]
        fill_slits(grid, 3, 1)
        np.testing.assert_array_equal(grid, expected)
