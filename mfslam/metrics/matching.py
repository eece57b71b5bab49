"""Poses of one instant: which pose belongs to which stamp."""

from __future__ import annotations

import numpy as np

from mfslam.types import BoolArray, IntArray, MfslamError

_NS = 1_000_000_000


def nearest(stamps_ns: IntArray, wanted_ns: IntArray, tolerance_s: float) -> tuple[IntArray, BoolArray]:
    """Index of the pose nearest in time to each wanted stamp, and whether it is near enough."""
    if len(stamps_ns) == 0:
        return np.zeros(len(wanted_ns), dtype=np.int64), np.zeros(len(wanted_ns), dtype=np.bool_)
    order = np.argsort(stamps_ns, kind="stable")  # the log's order need not be the clock's
    ordered = stamps_ns[order]
    right = np.minimum(np.searchsorted(ordered, wanted_ns), len(ordered) - 1)
    left = np.maximum(right - 1, 0)
    nearer_left = np.abs(ordered[left] - wanted_ns) <= np.abs(ordered[right] - wanted_ns)
    position = np.where(nearer_left, left, right)
    return order[position], np.abs(ordered[position] - wanted_ns) <= round(tolerance_s * _NS)


def range_text(stamps_ns: IntArray) -> str:
    if len(stamps_ns) == 0:
        return "nothing"
    return f"{stamps_ns.min() / _NS:.6f} to {stamps_ns.max() / _NS:.6f} s"


def associate(a_ns: IntArray, b_ns: IntArray, max_difference_s: float = 0.01) -> tuple[IntArray, IntArray]:
    """Indices into ``a_ns`` and ``b_ns`` of poses of one instant: each of a with its nearest of b.

    Raises MfslamError, telling both time ranges, when there are none.
    """
    index, found = nearest(b_ns, a_ns, max_difference_s)
    if not found.any():
        raise MfslamError(
            f"no poses within {max_difference_s} s of each other: one trajectory runs from {range_text(a_ns)}, "
            f"the other from {range_text(b_ns)}"
        )
    return np.flatnonzero(found), index[found]
