"""Small charts as inline SVG; colours come from the page's style sheet (classes c-scan, c-loop, ...)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

from mfslam.types import FloatArray

WIDTH, HEIGHT = 560, 230
LEFT, RIGHT, TOP, BOTTOM = 52, 12, 10, 38


@dataclass(frozen=True, eq=False)
class Series:
    """One line of a chart: ``y`` over ``x`` (N,), the shade between ``low`` and ``high`` when given."""

    name: str
    css: str
    x: FloatArray
    y: FloatArray
    low: FloatArray | None = None
    high: FloatArray | None = None
    dashed: bool = False


@dataclass(frozen=True)
class _Frame:
    x_max: float
    y_max: float

    def px(self, x: FloatArray) -> FloatArray:
        return np.asarray(LEFT + np.asarray(x) / self.x_max * (WIDTH - LEFT - RIGHT))

    def py(self, y: FloatArray) -> FloatArray:
        share = np.clip(np.asarray(y) / self.y_max, 0.0, 1.0)
        return np.asarray(HEIGHT - BOTTOM - share * (HEIGHT - TOP - BOTTOM))


def line_chart(series: Sequence[Series], x_label: str, y_label: str, x_max: float | None = None) -> str:
    """Lines over x >= 0, y >= 0, with axes and a legend when there are several."""
    drawn = [s for s in series if len(s.x)]
    if not drawn:
        return '<p class="none">nothing to show</p>'
    tops = [float(np.max(s.y if s.high is None else s.high)) for s in drawn]
    frame = _Frame(x_max or max(float(np.max(s.x)) for s in drawn) or 1.0, 1.05 * max(tops) or 1.0)
    body = [_axes(frame, x_label, y_label)]
    for s in drawn:
        if s.low is not None and s.high is not None:
            there = _points(frame, s.x, s.high)
            back = _points(frame, s.x[::-1], s.low[::-1])
            body.append(f'<polygon class="band {s.css}" points="{there} {back}"/>')
    for s in drawn:
        dash = ' stroke-dasharray="5 4"' if s.dashed else ""
        body.append(f'<polyline class="line {s.css}"{dash} points="{_points(frame, s.x, s.y)}"/>')
    legend = _legend(drawn) if len(drawn) > 1 else ""
    return legend + _svg("".join(body), HEIGHT, f"{y_label} over {x_label}")


def bar_chart(values: Sequence[tuple[str, float]], unit: str) -> str:
    """Horizontal bars, one per named value, widest first as given."""
    if not values:
        return '<p class="none">nothing to show</p>'
    top = max(value for _, value in values) or 1.0
    row = 24
    body = []
    for index, (name, value) in enumerate(values):
        y = 6 + index * row
        width = max(1.0, value / top * (WIDTH - 240))
        body.append(
            f'<text class="label" x="150" y="{y + 13}" text-anchor="end">{escape(name)}</text>'
            f'<rect class="bar" x="160" y="{y + 2}" width="{width:.1f}" height="15" rx="2"/>'
            f'<text class="value" x="{166 + width:.1f}" y="{y + 13}">{value:.3g} {escape(unit)}</text>'
        )
    return _svg("".join(body), 12 + row * len(values), "bars")


def binned(
    x: FloatArray, y: FloatArray, bins: int = 200
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """x, and the 5 %, 50 % and 95 % quantiles of y, over ``bins`` equal stretches of x; empty ones dropped."""
    if len(x) == 0:
        empty = np.zeros(0)
        return empty, empty, empty, empty
    span = float(np.max(x)) or 1.0
    which = np.minimum((x / span * bins).astype(np.int64), bins - 1)
    order = np.lexsort((y, which))
    values = y[order]
    starts = np.searchsorted(which[order], np.arange(bins + 1))
    count = np.diff(starts)
    filled = np.flatnonzero(count)

    def quantile(share: float) -> FloatArray:
        index = starts[filled] + np.round(share * (count[filled] - 1)).astype(np.int64)
        return np.asarray(values[index])

    return (filled + 0.5) * span / bins, quantile(0.05), quantile(0.5), quantile(0.95)


def ticks(top: float, about: int = 5) -> list[float]:
    """Round numbers from 0 to ``top``."""
    raw = top / about
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(m * power for m in (1, 2, 2.5, 5, 10) if m * power >= raw * 0.999)
    return [step * n for n in range(int(top / step + 1e-9) + 1)]


def _axes(frame: _Frame, x_label: str, y_label: str) -> str:
    out = []
    for value in ticks(frame.y_max, 4):
        y = float(frame.py(np.array(value)))
        out.append(
            f'<line class="grid" x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{y:.1f}" y2="{y:.1f}"/>'
            f'<text class="tick" x="{LEFT - 6}" y="{y + 4:.1f}" text-anchor="end">{value:.4g}</text>'
        )
    for value in ticks(frame.x_max, 6):
        x = float(frame.px(np.array(value)))
        out.append(
            f'<text class="tick" x="{x:.1f}" y="{HEIGHT - BOTTOM + 16}" text-anchor="middle">{value:.4g}</text>'
        )
    middle_x, middle_y = (LEFT + WIDTH - RIGHT) / 2, (TOP + HEIGHT - BOTTOM) / 2
    out.append(
        f'<text class="axis" x="{middle_x}" y="{HEIGHT - 4}" text-anchor="middle">{escape(x_label)}</text>'
        f'<text class="axis" transform="translate(12 {middle_y}) rotate(-90)" text-anchor="middle">'
        f"{escape(y_label)}</text>"
    )
    return "".join(out)


def _points(frame: _Frame, x: FloatArray, y: FloatArray) -> str:
    return " ".join(
        f"{px:.1f},{py:.1f}" for px, py in zip(frame.px(x).tolist(), frame.py(y).tolist(), strict=True)
    )


def _legend(series: Sequence[Series]) -> str:
    items = "".join(
        f'<span><i class="{"dash " if s.dashed else ""}{s.css}"></i>{escape(s.name)}</span>' for s in series
    )
    return f'<div class="legend">{items}</div>'


def _svg(body: str, height: int, label: str) -> str:
    return f'<svg class="chart" viewBox="0 0 {WIDTH} {height}" role="img" aria-label="{escape(label)}">{body}</svg>'
