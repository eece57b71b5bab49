"""A page of plots and tables of an evaluation: one file that opens offline."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np

from mfslam.evaluation.scores import Errors, Score
from mfslam.evaluation.tables import Rows, shown
from mfslam.output.charts import Series, binned, line_chart
from mfslam.output.page import html_page
from mfslam.types import FloatArray

COLOURS = (
    "c-scan",
    "c-loop",
    "c-good",
    "c-heading",
    "c-bad",
    "c-unsure",
    "c-odometry",
    "c-rose",
)  # of the style sheet, in order
_BANDED = 3  # results whose bands can be told apart
_NAMED = 4  # results that a title can name
_POINTS = 3000  # of a path that is drawn
_CDF = 200


def evaluation_page(
    scores: Sequence[Score], tables: Sequence[tuple[str, Rows]], against: str, x_label: str
) -> str:
    """All tables and plots; ``x_label``: what errors are drawn over."""
    names = ", ".join(shown(score.name) for score in scores)
    if len(scores) > _NAMED:
        names = f"{len(scores)} results"
    body = [
        f"<header><h1>{escape(names)}</h1><p>held against {escape(against)} by mfslam evaluate</p></header>",
        _paths(scores),
        f'<h2>Errors</h2><div class="grid2">{"".join(_plots(scores, x_label))}</div>',
        f"<h2>In numbers</h2>{''.join(table_card(title, rows) for title, rows in tables)}",
    ]
    return html_page(f"evaluation of {names}", body)


def table_card(title: str, rows: Rows) -> str:
    head = "".join(f"<th>{escape(cell)}</th>" for cell in rows[0])
    body = "".join(
        f"<tr><th>{escape(row[0])}</th>{''.join(f'<td>{escape(cell)}</td>' for cell in row[1:])}</tr>"
        for row in rows[1:]
    )
    return f'<div class="card span"><h3>{escape(title)}</h3><table class="numbers"><thead><tr>{head}</tr></thead>{body}</table></div>'


def colour(index: int) -> str:
    """Classes of a result's lines: dashed when the colours come round again."""
    return COLOURS[index % len(COLOURS)] + (" dashed" if index >= len(COLOURS) else "")


def card(title: str, note: str, content: str) -> str:
    return f'<div class="card"><h3>{escape(title)}</h3><p class="note">{escape(note)}</p>{content}</div>'


def _plots(scores: Sequence[Score], x_label: str) -> list[str]:
    out = []
    for metric, what in (("relations", "relations"), ("poses", "poses, best alignment")):
        errors = [(n, shown(score.name), getattr(score, metric)) for n, score in enumerate(scores)]
        drawn: list[tuple[int, str, Errors]] = [item for item in errors if item[2] is not None]
        if not drawn:
            continue
        for unit in ("m", "deg"):
            curves = [_cumulative(n, name, getattr(e, unit)) for n, name, e in drawn]
            far = max(float(np.percentile(getattr(e, unit), 99)) for _, _, e in drawn) or 1.0
            out.append(
                card(f"Error of {what} ({unit})", "Share of the errors that are below, in %.",
                     line_chart(curves, f"error ({unit})", "share below (%)", far))
            )  # fmt: skip
            banded = len(drawn) <= _BANDED
            over = [_over(n, name, e.at, getattr(e, unit), banded) for n, name, e in drawn]
            out.append(
                card(
                    f"Error of {what}, along the way ({unit})",
                    "Median, and 5 to 95 %." if banded else "Median.",
                    line_chart(over, x_label, f"error ({unit})"),
                )
            )
    along = [_drift(n, score) for n, score in enumerate(scores) if score.drift]
    if along:
        out.append(
            card(
                "Error against distance travelled",
                "Mean over all stretches of that length.",
                line_chart(along, "length (m)", "error (m)"),
            )
        )
    return out


def _cumulative(index: int, name: str, values: FloatArray) -> Series:
    share = np.linspace(0.0, 100.0, _CDF)
    return Series(name, colour(index), np.percentile(values, share), share)


def _over(index: int, name: str, at: FloatArray, values: FloatArray, banded: bool) -> Series:
    x, low, middle, high = binned(at, values, 80)
    return Series(name, colour(index), x, middle, *((low, high) if banded else ()))


def _drift(index: int, score: Score) -> Series:
    x = np.array([0.0, *(row.length_m for row in score.drift)])
    return Series(
        shown(score.name), colour(index), x, np.array([0.0, *(row.translation_m for row in score.drift)])
    )


def _paths(scores: Sequence[Score]) -> str:
    drawn = [
        (shown(score.name), colour(n), score.path) for n, score in enumerate(scores) if score.path is not None
    ]
    truth = next((score.true_path for score in scores if score.true_path is not None), None)
    if truth is not None:
        drawn.insert(0, ("truth", "c-expected", truth))
    note = (
        "In the truth's frame."
        if truth is not None
        else "Each in its own frame: relations need no common one."
    )
    return f"<h2>Paths</h2>{card('Where the robot went', note, path_picture(drawn))}"


def path_picture(paths: Sequence[tuple[str, str, FloatArray]]) -> str:
    """Paths (N, 2+) as SVG, name and colour class of each; y up, one scale for both axes."""
    points = np.vstack([path[:, :2] for _, _, path in paths])
    low, high = points.min(axis=0), points.max(axis=0)
    span = np.maximum(high - low, 1e-3)
    width, height = 1100.0, float(np.clip(1100.0 * span[1] / span[0], 160.0, 700.0))
    scale = float(min((width - 40) / span[0], (height - 40) / span[1]))
    lines = []
    for _, css, path in paths:
        some = path[:: max(1, len(path) // _POINTS), :2]
        x = 20 + (some[:, 0] - low[0]) * scale
        y = height - 20 - (some[:, 1] - low[1]) * scale
        text = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x.tolist(), y.tolist(), strict=True))
        lines.append(f'<polyline class="line {css}" points="{text}"/>')
    legend = "".join(f'<span><i class="{css}"></i>{escape(name)}</span>' for name, css, _ in paths)
    bar = _round_length(0.2 * span[0])
    mark = (
        f'<line x1="20" x2="{20 + bar * scale:.1f}" y1="{height - 6:.0f}" y2="{height - 6:.0f}" class="line c-expected"/>'
        f'<text class="tick" x="{26 + bar * scale:.1f}" y="{height - 2:.0f}">{bar:g} m</text>'
    )
    return (
        f'<div class="legend">{legend}</div><svg class="chart" viewBox="0 0 {width:.0f} {height:.0f}" role="img" '
        f'aria-label="paths">{"".join(lines)}{mark}</svg>'
    )


def _round_length(about: float) -> float:
    power = 10.0 ** np.floor(np.log10(about))
    return float(max(m * power for m in (1.0, 2.0, 5.0) if m * power <= max(about, power) * 1.0001))
