"""The report's plots: speed, time per stage, what the edges leave open."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from mfslam.output.charts import Series, bar_chart, binned, line_chart
from mfslam.output.summary import KINDS, Residuals, edge_residuals, forward_seconds
from mfslam.output.tables import caption
from mfslam.types import Edge, EdgeKind, FloatArray, IntArray, RunResult

_SIGMAS_SHOWN = 6.0
_STRETCHES = 80  # of the log, each with one median and one band


def plot_cards(result: RunResult, summary: dict[str, Any]) -> str:
    """All plots of a run as HTML cards."""
    seconds = forward_seconds(result.stamps_ns)
    unit, scale = ("min", 60.0) if len(seconds) and seconds[-1] > 300 else ("s", 1.0)
    residuals = edge_residuals(result.world_T_body[result.keyframes], result.edges)
    open_m = _over_time(seconds[result.keyframes] / scale, result.edges, residuals)
    time_label = f"time ({unit})"
    return (
        _card(
            "Speed",
            "Of the optimised trajectory, over windows of a second.",
            line_chart([_speed(result.world_T_body, seconds, scale)], time_label, "m/s"),
        )
        + _card("Time per stage", "Seconds of this run.", bar_chart(_stages(summary), "s"))
        + _card(
            "What the edges leave open",
            "Distance between an edge and the final trajectory: median, and 5 to 95 %.",
            line_chart(open_m, time_label, "residual (cm)"),
        )
        + _card(
            "Residuals against their own noise",
            "Against the solved graph, not against the truth: where several edges tell the noise of one scan, what is left "
            "of them lies left of the dashed curve. Right of it they promise too much.",
            line_chart(
                _histograms(result.edges, residuals), "residual (sigmas)", "share per sigma", _SIGMAS_SHOWN
            ),
        )
    )


def _card(title: str, note: str, chart: str) -> str:
    return f'<div class="card"><h3>{title}</h3><p class="note">{note}</p>{chart}</div>'


def _stages(summary: dict[str, Any]) -> list[tuple[str, float]]:
    timings = summary.get("timings_s")
    return [(caption(k), float(v)) for k, v in timings.items()] if isinstance(timings, dict) else []


def _speed(world_T_body: FloatArray, seconds: FloatArray, scale: float) -> Series:
    """Speed over windows of at least a second: stamps of single scans may come in bursts."""
    if len(seconds) < 2 or seconds[-1] <= 0:
        return Series("speed", "c-scan", np.zeros(0), np.zeros(0))
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(world_T_body[:, :2], axis=0).T))])
    edges = np.linspace(0.0, seconds[-1], max(2, int(seconds[-1]) + 1))
    speed = np.diff(np.interp(edges, seconds, along)) / np.diff(edges)
    x, low, middle, high = binned((edges[:-1] + 0.5 * np.diff(edges)) / scale, speed)
    return Series("speed", "c-scan", x, middle, low, high)


def _of_kind(edges: list[Edge], kind: EdgeKind) -> IntArray:
    return np.array([n for n, edge in enumerate(edges) if edge.kind == kind], dtype=np.int64)


def _over_time(keyframe_time: FloatArray, edges: list[Edge], residuals: Residuals) -> list[Series]:
    out = []
    for kind in ("scan", "loop", "odometry"):
        chosen = _of_kind(edges, kind)
        when = keyframe_time[[edges[n].j for n in chosen.tolist()]]
        x, low, middle, high = binned(when, 100.0 * residuals.translation_m[chosen], _STRETCHES)
        out.append(Series(kind, f"c-{kind}", x, middle, low, high))
    return out


def _histograms(edges: list[Edge], residuals: Residuals) -> list[Series]:
    """Density of the normalised residuals per kind, and what three free directions should give."""
    out = []
    for kind in KINDS[:-1]:
        sigmas = residuals.sigmas[_of_kind(edges, kind)]
        if len(sigmas) == 0:
            continue
        bins = min(max(math.isqrt(len(sigmas)), 6), 48)
        width = _SIGMAS_SHOWN / bins
        shown = np.minimum(sigmas, _SIGMAS_SHOWN - 0.5 * width)  # all beyond stand in the last bin
        count, _ = np.histogram(shown, bins, (0.0, _SIGMAS_SHOWN))
        density = count.astype(np.float64) / (len(sigmas) * width)
        out.append(Series(kind, f"c-{kind}", ((np.arange(bins) + 0.5) * width).astype(np.float64), density))
    if out:
        x = np.linspace(0.0, _SIGMAS_SHOWN, 100, dtype=np.float64)
        chi = math.sqrt(2.0 / math.pi) * x**2 * np.exp(-0.5 * x**2)
        out.append(Series("expected of three free directions", "c-expected", x, chi, dashed=True))
    return out
