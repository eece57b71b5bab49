"""Every kernel, called with small arguments of the types that the engine uses."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mfslam.kernels import (
    align,
    align_moving,
    block_cholesky,
    cells,
    correlate,
    ends,
    evidence,
    glass,
    graph_terms,
    half_matrix,
    matrices,
    partners,
    patches,
    poses,
    raytrace,
    reach,
    scans,
    smoothing,
    surfels,
    tracks,
    wall_patches,
    wall_terms,
    walls,
    wheel_steps,
)
from mfslam.types import FloatArray


def _seen() -> tuple[FloatArray, FloatArray]:
    """Points and normals (40, 2) of a round wall."""
    angles = np.linspace(-1.5, 1.5, 40)
    out = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return 2.0 * out, -out


def _call_scans() -> None:
    points, normals = _seen()
    scans.oriented_points(
        np.full(40, 2.0, np.float32),
        -normals,
        np.zeros(40),
        np.zeros(3),
        np.ones(3),
        0.1,
        10.0,
        0.08,
        0.01,
        0.05,
        True,
    )
    ends.wall_ends(
        np.full(40, 2.0, np.float32), -normals, np.zeros(40), np.zeros(3), np.ones(3), 0.1, 10.0, 0.01
    )
    cells.smooth_surface(cells.build_cells(np.hstack([points, normals]), 0.25), 0.25, 0.1, 0.05)


def _call_poses() -> None:
    points, normals = _seen()
    pose = poses.compose(np.zeros(3), poses.between(np.zeros(3), np.ones(3)))
    poses.advance(poses.interpolate(np.zeros(3), pose, 0.5), poses.log(pose), 0.1)
    poses.off_in_sigmas(pose, pose, np.ones(3))
    poses.transform_points(pose, points, normals, np.empty((len(points), 4)))
    information = matrices.drop_open_direction(matrices.add_error(np.eye(3), 0.1, 0.1), 0.01)
    matrices.open_direction(information, 0.01)
    matrices.upper_root(information, 1e-6, 1e-9)
    steps = np.zeros((2, 3))
    wheel_steps.told_steps(wheel_steps.told_twists(wheel_steps.true_twists(steps, steps), steps), steps)
    wheel_steps.step_sigmas(wheel_steps.advance_by_told(pose, pose, pose), np.ones((3, 3)))
    wheel_steps.true_step(pose, pose)
    wheel_steps.weigh_steps(steps, steps, steps, np.ones((2, 3)), pose, np.ones((3, 3)), 3.0)
    tracks.mean_twist(np.arange(2.0), steps, 2, 0.0, 1.0)
    tracks.pose_at(np.arange(2.0), steps, 2, 0.5)


def _call_registration() -> None:
    points, normals = _seen()
    table, pose = cells.build_cells(np.hstack([points, normals]), 0.25), np.zeros(3)
    align.point_to_line(table, 0.25, points, normals, pose, pose, np.eye(3), 0.02, 3.0, 0.5, 0.1, 3, 0.01)
    held = matrices.of_sigmas(np.ones(3))
    align.point_to_line_match(
        table, 0.25, points, normals, pose, pose, held, 0.02, 3.0, 0.5, 0.1, 3, 0.01, 0.1, 0.01, 0.01
    )
    align.honest_information(np.eye(3), 0.02, 0.02, 0.1, 0.01, 0.01)
    align.point_to_point(table, table, 0.25, pose, 0.5, 0.1, 3, True)
    align.rigid_fit(points, points)
    align_moving.point_to_line_moving(
        table,
        0.25,
        points,
        normals,
        np.zeros(len(points)),
        pose,
        np.zeros(6),
        np.eye(6),
        0.02,
        3.0,
        0.5,
        0.1,
        3,
        0.01,
    )


def _call_loop_closure() -> None:
    points, _ = _seen()
    corner, pose = np.array([-3.0, -3.0]), np.zeros(3)
    levels = correlate.pyramid(correlate.likelihood_grid(points, corner, 60, 60, 0.1, 0.1), 3)
    correlate.branch_and_bound(levels, corner, 0.1, points, pose, np.zeros(1), 0.3, 0.1, 1, 1.0, 1.0)
    grid = evidence.evidence_grid(np.zeros((1, 2)), np.array([0, len(points)]), points, corner, 60, 60, 0.1)
    evidence.agreement(grid, corner, 0.1, pose, points)
    reach.carried(pose, np.eye(3))
    ends = np.array([0, 1])
    reach.path_covariances(
        0, np.eye(3), np.zeros((2, 3)), ends, np.array([-1, -1]), ends, np.ones((1, 3, 3)), 1.0
    )


def _call_adjustment() -> None:
    points, normals = _seen()
    table = cells.build_cells(np.hstack([points, normals]), 0.25)
    count, scan = len(points), np.zeros((1, 3))
    first = np.array([0, count])
    placed = np.empty((count, 4))
    wall_patches.place_scans(points, normals, first, scan, placed)
    patch, seen = partners.nothing_known(count)
    seeds = cells.build_cells(wall_patches.seed_patches(table, 0.25, 0.25), 0.25)
    partners.find_partners(*seeds, 0.25, placed, 0.25, 0.7, patch, seen)
    size, patch = len(seeds[1]), patch.astype(np.int32)
    lines = wall_patches.fit_patches(size, points, first, scan, patch, np.empty((0, 5)), 0.1)
    origins, spare = np.zeros((1, 2)), np.ones(count, np.float32)
    groups = wall_patches.group_sums(
        points, origins, spare, normals, first, scan, patch, lines, 0.02, 0.005, 0.1
    )
    scan_of, patch_of, sums = groups
    terms, weights = np.zeros((size, 7)), np.ones(size)
    wall_terms.add_line_terms(patch_of, sums, terms)
    own, columns, rhs = np.zeros((1, 3, 3)), np.empty((len(sums), 3, 2), np.float32), np.zeros((1, 3))
    roots = wall_terms.line_roots(terms)
    wall_terms.eliminate_lines(roots, weights, scan_of, patch_of, sums, own, columns, rhs)
    walls = own, columns, scan_of, patch_of
    one_pose, coarse_of, room = np.zeros((3, 1)), np.zeros(1, np.int64), np.zeros((2 * size, 1))
    wall_terms.add_wall_product(*walls, one_pose, room, np.zeros((3, 1)))
    coarse = wall_terms.add_wall_stretches(*walls, size, 1, own, coarse_of, np.zeros((1, 3, 3)))
    wall_terms.wall_blocks(*coarse, size)


def _call_graph() -> None:
    first, rows = block_cholesky.factor_pattern(np.array([0, 0, 1]), np.array([0]))
    diagonal, below = np.tile(2.0 * np.eye(3), (2, 1, 1)), -np.eye(3)[None]
    place, one, rhs = np.array([-1, 0, 1]), np.zeros(1, np.int64), np.zeros((2, 3))
    edge = np.array([[1, 2]]), np.zeros((1, 3)), np.eye(3)[None]
    graph_terms.edge_chi2(*edge, np.zeros((3, 3)))
    graph_terms.normal_equations(*edge, np.ones(1), np.zeros((3, 3)), place, one, 1.0, diagonal, below, rhs)
    block_cholesky.factorise(first, rows, diagonal, below)
    lower = np.array([0, 1]), one, diagonal[:1]
    half_matrix.add_product(*lower, np.zeros((3, 1)), np.zeros((3, 1)))
    half_matrix.add_stretches(*lower, 1, diagonal[:1], one, np.zeros((1, 3, 3)))
    block_cholesky.substitute(first, rows, diagonal, below, rhs)
    graph_terms.moved_poses(np.zeros((3, 3)), place, rhs)
    block_cholesky.invert_selected(first, rows, diagonal, below)


def _call_smoothing() -> None:
    times, variances, begins = np.arange(3.0), np.ones(3), np.zeros(3, np.bool_)
    states, covariances = np.empty((3, 3)), np.empty((3, 3, 3))
    smoothing.run_forward(times, times, variances, begins, 1.0, states, covariances)
    smoothing.run_back(times, begins, 1.0, states, covariances)


_SHAPE, _ORIGIN_M = (2, 40), np.array([-4.0, -4.0])
_RANGES_M, _ANGLES_RAD, _TIMES_S = np.full(_SHAPE, 2.0, np.float32), np.linspace(-1.5, 1.5, 40), np.zeros(40)


def _placed() -> tuple[FloatArray, FloatArray, raytrace.KindArray]:
    """Starts and ends (2, 40, 2) and kinds (2, 40) of beams at a round wall."""
    starts, ends = np.zeros((*_SHAPE, 2)), np.empty((*_SHAPE, 2))
    ends[:] = _seen()[0]
    return starts, ends, np.full(_SHAPE, raytrace.HIT, np.int8)


def _empty_table() -> surfels.PatchTable:
    return np.full(64, surfels.EMPTY, np.int64), np.zeros((64, 5))


def _call_beams() -> None:
    starts, ends, kinds = _placed()
    raytrace.place_beams(
        _RANGES_M,
        np.zeros((2, 3)),
        np.ones((2, 6)),
        _ANGLES_RAD,
        _TIMES_S,
        np.zeros(3),
        (0.1, 10.0, 0.0),
        starts,
        ends,
        kinds,
    )
    raytrace.drop_mixed(_RANGES_M, starts, ends, kinds, 0.02, 0.08)
    raytrace.limit_range(starts, ends, kinds, 10.0, np.zeros(4))
    stops = np.empty_like(ends)
    raytrace.stop_short(starts, ends, kinds, 0.02, stops)
    flat = starts.reshape(-1, 2), stops.reshape(-1, 2), ends.reshape(-1, 2), kinds.ravel()
    hits, passes, nears = (np.zeros((80, 80), np.uint16) for _ in range(3))
    raytrace.trace_beams(*flat, _ORIGIN_M, 0.1, hits, passes, nears)
    facings = np.zeros(_SHAPE, np.int8)
    raytrace.bridge_hits(ends, kinds, facings, surfels.SECTORS, _ORIGIN_M, 0.1, 0.2, hits)


def _call_surfaces() -> None:
    starts, ends, kinds = _placed()
    facings = np.empty(_SHAPE, np.int8)
    keys, sums, _ = surfels.add_hits(*_empty_table(), 0, starts, ends, kinds, 0.08, 0.02, 0.06, facings)
    surfels.patch_place(surfels.find_patch(keys, 0, 0, 0))
    lines = surfels.fit_surfaces(keys, sums, np.flatnonzero(keys != surfels.EMPTY), 0.06, 0.02, 1)
    surfels.adjust_ends(keys, lines, 0.06, 0.02, facings, starts, kinds, ends)


def _call_glass() -> None:
    keys, sums = _empty_table()
    lines, met = np.zeros((64, 5)), np.zeros(64, np.int64)
    glass.count_square(
        lines, _RANGES_M, np.zeros((2, 3)), np.zeros((2, 6)), _ANGLES_RAD, _TIMES_S, np.zeros(3), (0.1, 10.0, 8.0), 0.02, met,
        met.copy(),
    )  # fmt: skip
    glass.share_behind(keys, sums, lines, 0.06, 0.02)
    runs = glass.keep_runs(keys, lines, met > 0, 0.06, 0.02, 1)
    glass.draw_lines(lines[runs], 0.03, _ORIGIN_M, 0.1, np.zeros((80, 80), np.bool_))


def _call_judging() -> None:
    hits = np.zeros((80, 80), np.uint16)
    hits[40, 20:60] = 5
    occupied = hits > 0
    found = np.ascontiguousarray(np.argwhere(occupied))
    density = np.zeros(hits.shape, np.float32)
    walls.smooth_hits(hits, found, np.ones(3), 0, density)
    is_flank, _ = walls.find_flanks(density, 0, found, 1, 2, 1)
    flanks = np.concatenate([found[is_flank]])
    walls.thin_walls(occupied, flanks)
    walls.drop_islands(occupied.view(np.uint8), flanks)
    free = ~occupied
    patches.drop_crumbs(free, 1, 1, found)
    patches.fill_slits(free.view(np.int8), 2, 1)


# together all kernels; those of one group call the same helpers. The dearest to compile first
SAMPLES: tuple[Callable[[], None], ...] = (
    _call_graph, _call_registration, _call_adjustment, _call_loop_closure, _call_beams, _call_surfaces, _call_scans,
    _call_judging, _call_glass, _call_poses, _call_smoothing,
)  # fmt: skip
