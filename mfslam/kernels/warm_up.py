"""Compile every kernel once, before the work, and say what it costs."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from mfslam.kernels import align, cells, correlate, evidence, matrices, poses, raytrace, reach, scans, walls


def compile_once(tell: Callable[[str], None]) -> float:
    """Make sure that compiled kernels lie in the cache; returns the CPU seconds it took (0: they did)."""
    if all(_is_cached(kernel) for kernel in _kernels()):
        return 0.0
    tell("first run: compiling kernels (once per installation, some 20 s) ...")
    start_s = time.process_time()
    call_all()
    cpu_s = time.process_time() - start_s
    tell(f"kernels compiled in {cpu_s:.0f} CPU s; later runs load them at once")
    return cpu_s


def _kernels() -> list[Any]:
    modules = (align, cells, correlate, evidence, matrices, poses, raytrace, reach, scans, walls)
    return [
        item
        for module in modules
        for name, item in vars(module).items()
        if not name.startswith("_") and hasattr(item, "py_func") and item.__module__ == module.__name__
        and not item.targetoptions.get("inline")
    ]  # fmt: skip


def _is_cached(kernel: Any) -> bool:
    """Whether numba holds a valid compiled version on disk (its cache has no public question for that)."""
    try:
        return bool(kernel.signatures or kernel._cache._cache_file._load_index())
    except (AttributeError, OSError):
        return False


def call_all() -> None:
    """Call every kernel with small arguments of the types that the engine uses."""
    angles = np.linspace(-1.5, 1.5, 40)
    ranges = np.full(40, 2.0, np.float32)
    zero = np.zeros(3)
    points, beams = scans.project_beams(ranges, angles, np.zeros(40), zero, np.ones(3), 0.1, 10.0)
    normals = scans.estimate_normals(points, beams, zero[:2], 0.08, 0.01)
    scans.thin_points(points, normals, 0.05)
    oriented = np.empty((len(points), 4))
    poses.transform_points(poses.compose(zero, poses.between(zero, zero)), points, normals, oriented)
    table = cells.build_cells(oriented, 0.25)
    cells.smooth_surface(table, 0.25, 0.1, 0.05)
    align.point_to_line(table, 0.25, points, normals, zero, zero, np.eye(3), 0.02, 3.0, 0.5, 0.1, 3)
    corner = np.array([-3.0, -3.0])
    levels = correlate.pyramid(correlate.likelihood_grid(points, corner, 60, 60, 0.1, 0.1), 3)
    correlate.branch_and_bound(levels, corner, 0.1, points, zero, np.zeros(1), 0.3, 0.1, zero)
    grid = evidence.evidence_grid(np.zeros((1, 2)), np.array([0, len(points)]), points, corner, 60, 60, 0.1)
    evidence.agreement(grid, corner, 0.1, zero, points)
    reach.relative_sigmas(0, np.zeros((2, 3)), np.array([0, 1, 2]), np.array([1, 0]), np.ones((2, 2)))
