"""The folder that a run leaves behind: checked before the work, written whole after it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from mfslam.config import Config
from mfslam.output import covariance, g2o, maps, ply, report, tum
from mfslam.output.staging import PART_SUFFIX, Staging, cannot_write, check_writable
from mfslam.output.summary import json_text, summarise
from mfslam.settings import describe
from mfslam.types import MfslamError, OccupancyGrid, RunResult

RUN_MARKS = ("summary.json", "map.pgm")


@contextmanager
def run_folder(folder: Path, overwrite: bool = False) -> Iterator[None]:
    """`prepare_folder` around a run: when it fails, folders that were made for it are gone again.

    Raises MfslamError.
    """
    new = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        prepare_folder(folder, overwrite)
        yield
    except BaseException:
        with suppress(OSError):  # one that holds something stays, and so do its parents
            for path in new:
                path.rmdir()
        raise


def prepare_folder(folder: Path, overwrite: bool = False) -> None:
    """Make ``folder`` ready for a run, before any work is done.

    Raises MfslamError when it is no folder, cannot be written, or holds something and ``overwrite`` is
    off. Overwriting replaces the files of a run and leaves all others alone.
    """
    try:
        if folder.exists() and not folder.is_dir():
            raise MfslamError(f"{folder}: expected a folder for the output, this is a file")
        folder.mkdir(parents=True, exist_ok=True)
        for leftover in folder.glob(f".*{PART_SUFFIX}"):  # of a run that was killed while writing
            leftover.unlink()
        if not overwrite:
            _refuse_if_used(folder)
    except OSError as error:
        raise cannot_write(folder, error) from None
    check_writable(folder / "map.pgm")


def _refuse_if_used(folder: Path) -> None:
    if any((folder / mark).exists() for mark in RUN_MARKS):
        raise MfslamError(f"{folder}: already holds a run; give --overwrite to replace it, or another -o")
    if any(folder.iterdir()):
        raise MfslamError(f"{folder}: is not empty; give --overwrite to write into it, or another -o")


def write_run(
    result: RunResult, config: Config, folder: Path, summary: dict[str, Any] | None = None
) -> list[Path]:
    """Write every file of a run; returns their paths. ``summary``: that of the result, where it is known.

    All are written aside and renamed together at the end: when anything fails, `folder` is as it was.
    Map, trajectories, graph and points are the same bytes for the same result. Raises MfslamError.
    """
    _check(result)
    summary = summarise(result) if summary is None else summary
    names = []
    with Staging(folder) as staging:
        # one after the other: pictures of large grids and long texts are never in memory together; the image
        # before map.yaml, which may name another one until then (`growing_map`)
        _write_pictures(result.grid, staging)
        for name, text in _texts(result, config, summary):
            staging.write_text(name, text)
            names.append(name)
        with staging.open("points.ply") as file:
            ply.write_ply(result.points, file)
    return [folder / name for name in (*names, "map.pgm", "map.png", "points.ply")]


def _texts(result: RunResult, config: Config, summary: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Name and content of every text file."""
    stamps_ns, poses = result.stamps_ns, result.world_T_body
    config_yaml = describe(config)
    yield "map.yaml", maps.yaml_text(result.grid)
    yield "trajectory.tum", tum.trajectory_text(stamps_ns, poses)
    yield "trajectory.cov", covariance.covariances_text(stamps_ns, result.covariances)
    yield "keyframes.tum", tum.trajectory_text(stamps_ns[result.keyframes], poses[result.keyframes])
    yield "graph.g2o", g2o.graph_text(poses[result.keyframes], result.edges)
    yield "config.yaml", config_yaml
    yield "report.html", report.report_html(result, summary, config_yaml)
    yield "summary.json", json_text(summary)


def _write_pictures(grid: OccupancyGrid, staging: Staging) -> None:
    image = maps.grid_image(grid)
    with staging.open("map.pgm") as file:
        file.write(maps.pgm_bytes(image))
    with staging.open("map.png") as file:
        file.write(maps.png_bytes(image))


def _check(result: RunResult) -> None:
    """A result that is not finite must never reach the disk: that is a fault of ours, not of the input."""
    scans = len(result.stamps_ns)
    if result.world_T_body.shape != (scans, 3):
        raise ValueError(f"expected world_T_body of shape ({scans}, 3), got {result.world_T_body.shape}")
    if not np.isfinite(result.world_T_body).all():
        raise ValueError("the trajectory is not finite")
    if result.covariances.shape != (scans, 3, 3) or not np.isfinite(result.covariances).all():
        raise ValueError(
            f"expected finite covariances of shape ({scans}, 3, 3), got {result.covariances.shape}"
        )
