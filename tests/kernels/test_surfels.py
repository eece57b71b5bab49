"""Hits moved onto the surface that all scans agree on."""

import numpy as np
import pytest

from mfslam.kernels.raytrace import HIT
from mfslam.kernels.surfels import EMPTY, add_hits, adjust_ends, fit_surfaces, patch_place

PATCH, SIGMA = 0.06, 0.02


def scan_walls(walls_of, n_scans=40, beams=181, sigma=SIGMA, seed=0, first_slots=64):
    """Scans from points of y = 0, looking up or down at the ranges that ``walls_of`` says; adjusted ends with all."""
    rng = np.random.default_rng(seed)
    angles = np.radians(np.linspace(-60.0, 60.0, beams))
    starts = np.empty((n_scans, beams, 2))
    ends, kinds = np.empty_like(starts), np.full((n_scans, beams), HIT, np.int8)
    for k in range(n_scans):
        start, heading, distance = walls_of(k)
        starts[k] = start
        ranges = distance / np.cos(angles) + rng.normal(0.0, sigma, beams)
        ends[k] = start + ranges[:, None] * np.stack(
            [np.cos(heading + angles), np.sin(heading + angles)], axis=-1
        )
    raw, facings = ends.copy(), np.empty(kinds.shape, np.int8)
    keys, sums, used = add_hits(
        np.full(first_slots, EMPTY, np.int64), np.zeros((first_slots, 5)), 0, starts, ends, kinds,
        np.radians(120.0 / (beams - 1)), sigma, PATCH, facings,
    )  # fmt: skip
    lines = fit_surfaces(keys, sums, np.flatnonzero(keys != EMPTY), PATCH, sigma, 3)
    adjust_ends(keys, lines, PATCH, sigma, facings, starts, kinds, ends)
    assert used == np.sum(keys != EMPTY) <= len(keys) / 2
    assert sums[:, 0].sum() == np.sum(facings >= 0)
    return raw, ends


@pytest.mark.parametrize("turn_deg", [0.0, 22.5, 31.0, 90.0, -135.0])
def test_a_noisy_wall_becomes_a_line(turn_deg):
    turn = np.radians(turn_deg)
    along = np.array([np.cos(turn), np.sin(turn)])
    normal = np.array([-along[1], along[0]])
    raw, ends = scan_walls(lambda k: (0.05 * k * along + 7.0, turn + np.pi / 2, 2.0))
    middle = np.abs((raw - 7.0 - along) @ along) < 2.0  # its ends are seen by few
    off_raw, off = ((p - 7.0) @ normal - 2.0 for p in (raw, ends))
    assert np.sqrt(np.mean(off_raw[middle] ** 2)) > 0.01
    assert np.sqrt(np.mean(off[middle] ** 2)) < 0.005
    assert np.abs(np.mean(off[middle])) < 0.002, "the wall stays where it is"
    assert np.max(np.abs((ends - raw)[middle] @ along)) < 0.02, "hits move across it, not along"


def test_both_faces_of_a_thin_wall_stay():
    """Faces at y = 0.95 and 1.05, seen from y = 0 and y = 2 with noise of 2 cm."""

    def faces(k):
        x = 0.05 * (k // 2)
        return (np.array([x, 0.0]), np.pi / 2, 0.95) if k % 2 else (np.array([x, 2.0]), -np.pi / 2, 0.95)

    _, ends = scan_walls(faces, n_scans=80)
    inner = np.abs(ends[..., 0] - 0.5) < 0.8
    assert np.abs(np.mean(ends[1::2][inner[1::2]][:, 1]) - 0.95) < 0.003
    assert np.abs(np.mean(ends[0::2][inner[0::2]][:, 1]) - 1.05) < 0.003
    assert np.std(ends[1::2][inner[1::2]][:, 1]) < 0.006


def test_steps_of_several_sigmas_stay_steps():
    """A wall that steps back by 8 cm at x = 0.5, noise of 1 cm."""
    rng = np.random.default_rng(1)
    x = np.sort(rng.uniform(-0.5, 1.5, (200, 120)), axis=1)
    y = np.where(x < 0.5, 1.0, 1.08) + rng.normal(0.0, 0.01, x.shape)
    ends = np.ascontiguousarray(np.stack([x, y], axis=-1)[:, ::-1])
    starts, kinds = np.tile([0.5, 0.0], (*x.shape, 1)), np.full(x.shape, HIT, np.int8)
    facings = np.empty(kinds.shape, np.int8)
    keys, sums, _ = add_hits(
        np.full(64, EMPTY, np.int64), np.zeros((64, 5)), 0, starts, ends, kinds, 0.01, 0.01, PATCH, facings
    )
    lines = fit_surfaces(keys, sums, np.flatnonzero(keys != EMPTY), PATCH, 0.01, 3)
    adjust_ends(keys, lines, PATCH, 0.01, facings, starts, kinds, ends)
    left, right = ends[ends[..., 0] < 0.35], ends[ends[..., 0] > 0.65]
    assert np.abs(np.mean(left[:, 1]) - 1.0) < 0.003 and np.abs(np.mean(right[:, 1]) - 1.08) < 0.003


def test_keys_are_places():
    from mfslam.kernels.surfels import _key

    for ix, iy, sector in [(0, 0, 0), (-1, -1, 7), (123_456, -98_765, 3), (-50_000_000, 50_000_000, 5)]:
        assert patch_place(_key(ix, iy, sector)) == (ix, iy, sector)
