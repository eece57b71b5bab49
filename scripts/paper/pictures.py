"""The figures of the page. Colours after Okabe and Ito: told apart by colour-blind readers too."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle
from PIL import Image

from drivers.simulator import World
from mfslam.types import FloatArray
from paper.rig import Drive

BLUE, VERMILION, GREEN, ORANGE, GREY = "#0072B2", "#D55E00", "#009E73", "#E69F00", "#777777"
SERIES = [VERMILION, ORANGE, BLUE, GREEN]
WIDTH_IN, DPI = 9.0, 110


@dataclass(frozen=True, eq=False)
class ScanTriple:
    """Points (M, 2) of one scan in the body frame: from a standing robot, as told, and compensated."""

    stationary: FloatArray
    snapshot: FloatArray
    compensated: FloatArray


def _figure(height_in: float) -> Figure:
    return Figure(figsize=(WIDTH_IN, height_in), dpi=DPI, layout="constrained")


def _save(figure: Figure, path: Path) -> None:
    """As a picture of few colours: a third of the size. No date inside: the same runs give the same bytes."""
    drawn = BytesIO()
    figure.savefig(drawn, format="png")
    picture = Image.open(drawn).convert("RGB")
    picture.quantize(160, dither=Image.Dither.NONE).save(path, optimize=True)


def _plain(axes: Axes) -> None:
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(alpha=0.25, linewidth=0.6)


def draw_scans(scans: Mapping[str, ScanTriple], path: Path) -> None:
    figure = _figure(6.4)
    grid = figure.subplots(2, len(scans), sharex=True, sharey=True)
    for column, (speed, triple) in enumerate(scans.items()):
        rows = ((triple.snapshot, "as a snapshot", VERMILION), (triple.compensated, "compensated", GREEN))
        for row, (points, what, colour) in enumerate(rows):
            axes = grid[row, column]
            axes.plot(*points.T, ".", ms=2.2, color=colour, label=f"moving, {what}")
            axes.plot(*_broken(triple.stationary).T, color=BLUE, lw=1.4, label="standing")
            axes.plot(0, 0, marker=">", ms=7, color="black")
            axes.set_aspect("equal")
            _plain(axes)
            if row == 0:
                axes.set_title(speed)
            else:
                axes.set_xlabel("x ahead, m")
            if column == 0:
                axes.set_ylabel("y to the left, m")
            if column == len(scans) - 1:
                axes.legend(loc="upper right", markerscale=3, fontsize=8)
    _save(figure, path)


def _broken(points_m: FloatArray) -> FloatArray:
    """A scan's points (M, 2) as lines: NaN where neighbours are far apart."""
    gaps = np.flatnonzero(np.hypot(*np.diff(points_m, axis=0).T) > 0.2) + 1
    return np.insert(points_m, gaps, np.nan, axis=0)


def draw_by_beam(angles_deg: FloatArray, curves_m: Mapping[str, FloatArray], path: Path) -> None:
    figure = _figure(3.6)
    axes = figure.subplots()
    for colour, (name, error_m) in zip(SERIES, curves_m.items(), strict=True):
        axes.semilogy(angles_deg, 1e3 * error_m, color=colour, label=name, lw=1.6)
    axes.set_xlabel("bearing of the beam, deg (sensed from right to left)")
    axes.set_ylabel("systematic error at 3 m/s, mm")
    axes.set_xticks(np.arange(-120, 121, 30))
    axes.set_ylim(bottom=0.1)
    figure.legend(fontsize=8, ncols=2, loc="outside upper center")
    _plain(axes)
    _save(figure, path)


def draw_walls(axes: Axes, world: World, colour: str = "black", width: float = 0.9) -> None:
    axes.add_collection(
        LineCollection(list(world.segments.reshape(-1, 2, 2)), colors=colour, linewidths=width)
    )
    for x, y, radius in world.circles:
        axes.add_patch(Circle((x, y), radius, fill=False, color=colour, lw=width))
    corners = world.segments.reshape(-1, 2)
    axes.set_xlim(corners[:, 0].min() - 0.6, corners[:, 0].max() + 0.6)
    axes.set_ylim(corners[:, 1].min() - 0.6, corners[:, 1].max() + 0.6)
    axes.set_aspect("equal")
    axes.set_xlabel("x, m")


def draw_world(
    drive: Drive, overlay: tuple[FloatArray, FloatArray], box_m: tuple[float, float, float, float], path: Path
) -> None:
    """``overlay``: hits (P, 2) where they truly are, and as snapshots tell them, drawn within ``box_m``: x
    and y, from and to."""
    figure = _figure(7.2)
    grid = figure.add_gridspec(2, 2, height_ratios=[2.6, 1.0])
    model, scans, profile = (figure.add_subplot(grid[where]) for where in ((0, 0), (0, 1), (1, slice(None))))
    draw_walls(model, drive.world)
    times = np.arange(0.0, drive.motion.duration_s, 0.05)
    speed = drive.motion.twist_at(times)[:, 0]
    xy = drive.motion.at(times)[:, :2]
    lines = LineCollection(list(np.stack([xy[:-1], xy[1:]], axis=1)), cmap="viridis", lw=2.6)
    lines.set_array(speed[:-1])
    lines.set_clim(0.0, 3.0)
    model.add_collection(lines)
    model.plot(*xy[0], "o", color="black", ms=6)
    model.annotate("start", xy[0], (9, -3), textcoords="offset points", fontsize=9).set_bbox(
        {"facecolor": "white", "edgecolor": "none", "pad": 0.5}
    )
    model.add_patch(
        Rectangle((box_m[0], box_m[2]), box_m[1] - box_m[0], box_m[3] - box_m[2], fill=False, ls=":", lw=1.2)
    )
    figure.colorbar(lines, ax=model, label="speed, m/s", shrink=0.8, ticks=[0, 1, 2, 3])
    model.set_ylabel("y, m")
    model.set_title("world and route", fontsize=10)
    true, snapshots = overlay
    scans.plot(*snapshots.T, ".", ms=2.0, color=VERMILION, label="moving scans as snapshots")
    scans.plot(*true.T, ".", ms=1.4, color=BLUE, label="where the hits truly are")
    scans.set_xlim(*box_m[:2])
    scans.set_ylim(*box_m[2:])
    scans.set_aspect("equal")
    scans.set_xlabel("x, m")
    scans.set_ylabel("y, m")
    scans.set_title("scans from the true poses, dotted frame", fontsize=10)
    scans.legend(loc="lower left", markerscale=5, fontsize=8)
    profile.plot(times, speed, color=BLUE, label="speed, m/s")
    profile.plot(times, drive.motion.twist_at(times)[:, 2], color=ORANGE, lw=1.2, label="yaw rate, rad/s")
    profile.set_xlabel("time, s")
    profile.set_ylabel("m/s, rad/s")
    profile.legend(fontsize=8, ncols=2, loc="upper left")
    profile.set_xlim(0.0, times[-1])
    profile.set_ylim(top=4.2)
    _plain(profile)
    _save(figure, path)


@dataclass(frozen=True, eq=False)
class Curve:
    """An error by iteration: ``x_m``, ``y_m`` (16,), from before the first to after the fifteenth."""

    name: str
    colour: str
    dashed: bool
    x_m: FloatArray
    y_m: FloatArray


def draw_convergence(curves: list[Curve], path: Path) -> None:
    figure = _figure(3.6)
    for axes, along in zip(figure.subplots(1, 2), (True, False), strict=True):
        for curve in curves:
            error_m = curve.x_m if along else curve.y_m
            style = "--" if curve.dashed else "-"
            axes.plot(1e3 * error_m, style, marker="o", ms=3, color=curve.colour, label=curve.name, lw=1.4)
        axes.set_title(f"RMS error in {'X, along the driving' if along else 'Y, across it'}", fontsize=10)
        axes.set_xlabel("ICP iteration")
        axes.set_xticks(range(0, 16, 3))
        axes.set_ylim(bottom=0.0)
        axes.set_ylabel("mm")
        _plain(axes)
        if not along:
            axes.legend(fontsize=8)
    _save(figure, path)


def draw_maps(world: World, maps: Mapping[str, FloatArray], path: Path) -> None:
    """Points (P, 2) of several maps over the true walls, side by side."""
    figure = _figure(3.9)
    for axes, (title, points_m) in zip(figure.subplots(1, len(maps), sharey=True), maps.items(), strict=True):
        axes.plot(*points_m[::2].T, ",", color=BLUE)
        draw_walls(axes, world, VERMILION, 0.6)
        axes.set_title(title, fontsize=9)
    figure.axes[0].set_ylabel("y, m")
    _save(figure, path)
