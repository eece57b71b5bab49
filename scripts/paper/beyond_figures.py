"""Beyond the paper: where each way to map stops working, drawn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

from mfslam.types import BoolArray, FloatArray

WIDTH_IN, DPI = 9.0, 115
COLOURS = ("#000000", "#E69F00", "#0072B2", "#009E73", "#CC79A7", "#56B4E9")  # Okabe and Ito
BORDER = "#D55E00"
MARKERS = ("o", "s", "^", "D", "v", "P")


@dataclass(frozen=True)
class Heat:
    """One heat map: ``ate_m`` and ``usable`` (rows, columns); columns are what the robot does."""

    title: str
    ate_m: FloatArray
    usable: BoolArray


@dataclass(frozen=True)
class HeatRow:
    """Heat maps of every method over the same axes."""

    maps: Sequence[Heat]
    columns: Sequence[str]
    columns_label: str
    lines: Sequence[str]
    lines_label: str


def draw_frontier(path: Path, rows: Sequence[HeatRow]) -> None:
    """ATE over two factors for every method; a line around what is of use."""
    methods = len(rows[0].maps)
    figure = Figure(figsize=(WIDTH_IN, 2.35 * len(rows) + 0.5), layout="constrained")
    axes = figure.subplots(len(rows), methods, squeeze=False, sharey="row")
    norm = LogNorm(0.003, 3.0)
    image = None
    for line, row in zip(axes, rows, strict=True):
        for axis, heat in zip(line, row.maps, strict=True):
            image = axis.imshow(heat.ate_m, cmap="cividis", norm=norm, aspect="auto", origin="lower")
            _write_cells(axis, heat.ate_m)
            _outline(axis, heat.usable)
            axis.set_title(heat.title, fontsize=8)
            axis.set_xticks(range(len(row.columns)), row.columns)
            axis.set_yticks(range(len(row.lines)), row.lines)
            axis.set_xlabel(row.columns_label, fontsize=8)
            axis.tick_params(labelsize=8, length=0)
        line[0].set_ylabel(row.lines_label, fontsize=8)
    assert image is not None
    bar = figure.colorbar(image, ax=axes, fraction=0.03, pad=0.01)
    bar.set_label("trajectory error (ATE, RMS), m; in cells: cm", fontsize=8)
    bar.ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    bar.ax.tick_params(labelsize=8)
    figure.savefig(path, dpi=DPI)


def _write_cells(axis: Axes, ate_m: FloatArray) -> None:
    for (r, c), value in np.ndenumerate(ate_m):
        text = f"{100.0 * value:.1f}" if value < 0.0995 else f"{100.0 * value:.0f}"
        axis.text(c, r, text, ha="center", va="center", fontsize=7, color="white" if value < 0.1 else "black")


def _outline(axis: Axes, usable: BoolArray) -> None:
    """The border between cells of use and the others."""
    rows, columns = usable.shape
    lines: list[tuple[list[float], list[float]]] = []
    for r in range(rows):
        for c in range(columns):
            if c + 1 < columns and usable[r, c] != usable[r, c + 1]:
                lines.append(([c + 0.5, c + 0.5], [r - 0.5, r + 0.5]))
            if r + 1 < rows and usable[r, c] != usable[r + 1, c]:
                lines.append(([c - 0.5, c + 0.5], [r + 0.5, r + 0.5]))
    for x, y in lines:
        axis.plot(x, y, color=BORDER, linewidth=2.2, solid_capstyle="butt")


@dataclass(frozen=True)
class Panel:
    """Curves over one factor, by name. ``ticks``: texts below evenly spaced points instead of numbers."""

    title: str
    x_label: str
    x: Sequence[float]
    curves: dict[str, Sequence[float]]
    ticks: Sequence[str] | None = None
    y_label: str = ""
    limit: float | None = None
    logarithmic: bool = True


def draw_panels(path: Path, rows: Sequence[Sequence[Panel]], height_in: float) -> None:
    """Rows of panels, each row with one y axis; one legend for all."""
    figure = Figure(figsize=(WIDTH_IN, height_in), layout="constrained")
    axes = figure.subplots(len(rows), len(rows[0]), sharey="row", squeeze=False)
    names = list(dict.fromkeys(name for row in rows for panel in row for name in panel.curves))
    for line, row in zip(axes, rows, strict=True):
        for axis, panel in zip(line, row, strict=True):
            _draw_panel(axis, panel, names)
        line[0].set_ylabel(row[0].y_label, fontsize=8)
    found = [axis.get_legend_handles_labels() for axis in axes.flat]
    handles = {label: curve for curves, labels in found for curve, label in zip(curves, labels, strict=True)}
    figure.legend(
        handles.values(),
        handles.keys(),
        loc="outside upper center",
        ncols=len(handles),
        fontsize=8,
        frameon=False,
    )
    figure.savefig(path, dpi=DPI)


def _draw_panel(axis: Axes, panel: Panel, names: Sequence[str]) -> None:
    x = list(range(len(panel.x))) if panel.ticks else panel.x
    for name, values in panel.curves.items():
        n = names.index(name)
        axis.plot(x, values, color=COLOURS[n], marker=MARKERS[n], markersize=4, linewidth=1.5, label=name)
    if panel.ticks:
        axis.set_xticks(x, panel.ticks)
    if panel.limit is not None:
        axis.axhline(panel.limit, color=BORDER, linewidth=1.0, linestyle="--")
    if panel.logarithmic:
        axis.set_yscale("log")
        axis.yaxis.set_minor_formatter(NullFormatter())
    axis.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_title(panel.title, fontsize=8)
    axis.set_xlabel(panel.x_label, fontsize=8)
    axis.tick_params(labelsize=7)
    axis.grid(which="major", alpha=0.35)
    axis.spines[["top", "right"]].set_visible(False)


@dataclass(frozen=True)
class Staircase:
    """Yaw rates (rad/s) through a drive: true at every moment, and what each way believes of every scan, from
    ``starts_s`` (S,) for ``scan_s``."""

    title: str
    moments_s: FloatArray
    true_rad_s: FloatArray
    starts_s: FloatArray
    scan_s: float
    found_rad_s: dict[str, FloatArray]
    until_s: float


def draw_staircases(path: Path, panels: Sequence[Staircase]) -> None:
    """A panel per drive; every scan is a bar as long as it took."""
    columns = min(2, len(panels))
    rows = -(-len(panels) // columns)
    figure = Figure(figsize=(WIDTH_IN, 2.3 * rows + 0.5), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False, sharex=True)
    for axis, panel in zip(axes.flat, panels, strict=False):
        axis.plot(panel.moments_s, panel.true_rad_s, color="#999999", linewidth=3.5, label="true")
        for n, (name, found) in enumerate(panel.found_rad_s.items(), start=1):
            ends_s = panel.starts_s + panel.scan_s
            axis.hlines(found, panel.starts_s, ends_s, COLOURS[n], linewidth=2.6, label=name)
        axis.set_xlim(0.0, panel.until_s)
        axis.set_title(panel.title, fontsize=9)
        axis.tick_params(labelsize=8)
        axis.grid(which="major", alpha=0.35)
        axis.spines[["top", "right"]].set_visible(False)
    for line in axes:
        line[0].set_ylabel("yaw rate, rad/s", fontsize=8)
    for axis in axes[-1]:
        axis.set_xlabel("time, s", fontsize=8)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels), fontsize=8, frameon=False)
    figure.savefig(path, dpi=DPI)
