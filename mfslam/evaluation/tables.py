"""Scores as rows of text, for the terminal and the page."""

from __future__ import annotations

from typing import Any

from mfslam.evaluation.scores import Score
from mfslam.metrics import ErrorStats

Rows = list[list[str]]
_HEAD = ["", "matched", "mean", "std", "median", "99 %", "RMSE", "squared"]

_LONGEST = 40  # letters of a name


def shown(name: str) -> str:
    """The name, without its middle when it is long."""
    return name if len(name) <= _LONGEST else f"{name[:24]}...{name[-13:]}"


def score_tables(scores: list[Score], differences: list[dict[str, Any]]) -> list[tuple[str, Rows]]:
    """Title and rows of every table that has something to say."""
    tables = [
        ("Relations, m", _relations(scores, "translation_m", 4)),
        ("Relations, deg", _relations(scores, "rotation_deg", 3)),
        ("Absolute trajectory error, m", _absolute(scores, "translation_m", 4)),
        ("Absolute trajectory error, deg", _absolute(scores, "rotation_deg", 3)),
        ("Relative pose error", _relative(scores)),
        ("Error over stretches of the path, m / deg", _drift(scores)),
        ("Stated covariances (NEES: 1 is honest, more promises too much)", _nees(scores)),
        ("Differences (paired bootstrap over blocks)", _differences(differences)),
    ]
    return [(title, rows) for title, rows in tables if len(rows) > 1]


def as_text(rows: Rows) -> str:
    widths = [max(len(row[c]) for row in rows) for c in range(len(rows[0]))]
    return "\n".join(
        "  ".join(
            cell.ljust(w) if c == 0 else cell.rjust(w)
            for c, (cell, w) in enumerate(zip(row, widths, strict=True))
        )
        for row in rows
    )


def _stats(stats: ErrorStats, digits: int) -> list[str]:
    shown = (stats.mean, stats.std, stats.median, stats.p99, stats.rmse, stats.mean_squared)
    return [*(f"{value:.{digits}f}" for value in shown[:-1]), f"{shown[-1]:.3g}"]


def _relations(scores: list[Score], part: str, digits: int) -> Rows:
    rows = [_HEAD]
    for score in scores:
        error = score.relations_error
        if error is not None:
            count = f"{error.matched:,} of {error.matched + error.unmatched:,}"
            rows.append([shown(score.name), count, *_stats(getattr(error, part), digits)])
    return rows


def _absolute(scores: list[Score], part: str, digits: int) -> Rows:
    rows = [_HEAD]
    for score in scores:
        for alignment, error in score.ate.items():
            assert score.poses is not None
            count = f"{int(score.poses.matched.sum()):,} of {len(score.poses.matched):,}"
            named = {"none": "as it is", "origin": "first pose aligned", "best": "best alignment"}[alignment]
            rows.append([f"{shown(score.name)}, {named}", count, *_stats(getattr(error, part), digits)])
    return rows


def _relative(scores: list[Score]) -> Rows:
    rows = [["", "mean m", "RMSE m", "99 % m", "mean deg", "RMSE deg", "99 % deg"]]
    for score in scores:
        if score.rpe is not None:
            m, deg = score.rpe.translation_m, score.rpe.rotation_deg
            rows.append(
                [
                    shown(score.name),
                    *(f"{v:.4f}" for v in (m.mean, m.rmse, m.p99)),
                    *(f"{v:.3f}" for v in (deg.mean, deg.rmse, deg.p99)),
                ]
            )
    return rows


def _drift(scores: list[Score]) -> Rows:
    lengths = sorted({row.length_m for score in scores for row in score.drift})
    rows = [["", *(f"{length:g} m" for length in lengths)]]
    for score in scores:
        by_length = {row.length_m: f"{row.translation_m:.3f} / {row.rotation_deg:.2f}" for row in score.drift}
        if by_length:
            rows.append([shown(score.name), *(by_length.get(length, "-") for length in lengths)])
    return rows


def _nees(scores: list[Score]) -> Rows:
    rows = [["", "poses", "NEES", "within 95 %"]]
    for score in scores:
        if score.nees is not None:
            rows.append(
                [
                    shown(score.name),
                    f"{score.nees.poses:,}",
                    f"{score.nees.mean:.2f}",
                    f"{100 * score.nees.within:.0f} %",
                ]
            )
    return rows


def _differences(differences: list[dict[str, Any]]) -> Rows:
    rows = [["", "pairs", "mean difference", "95 % interval", "p", "verdict"]]
    for d in differences:
        low, high = d["interval_95"]
        a, b = shown(d["a"]), shown(d["b"])
        better = b if d["mean_difference"] < 0 else a
        verdict = f"{better} is better" if d["significant"] else "no real difference"
        rows.append([
            f"{b} minus {a}, {d['metric']}, {d['unit']}", f"{d['pairs']:,}", f"{d['mean_difference']:+.4f}",
            f"{low:+.4f} to {high:+.4f}", f"{d['p_value']:.3f}", verdict,
        ])  # fmt: skip
    return rows
