"""report.html: one file that opens offline in any browser and tells how a run went."""

from __future__ import annotations

from html import escape
from typing import Any

import numpy as np

from mfslam.observability import OPEN_SIGMA_M
from mfslam.output.overlay import map_layers
from mfslam.output.page import html_page
from mfslam.output.plots import plot_cards
from mfslam.output.tables import calibration_cards, caption, section_tables, value_text
from mfslam.types import IntArray, RunResult


def report_html(result: RunResult, summary: dict[str, Any], config_yaml: str) -> str:
    """The whole page. ``summary`` is what `mfslam.output.summarise` made of ``result``."""
    title = _title(summary)
    body = [
        f"<header><h1>{escape(title)}</h1><p>{escape(_subtitle(summary))}</p></header>",
        _tiles(summary),
        _warnings(result, summary),
        _map(result, summary),
        f'<h2>How it went</h2><div class="grid2">{plot_cards(result, summary)}</div>',
        _calibration(summary),
        f'<h2>In numbers</h2><div class="grid3">{section_tables(summary)}</div>',
        f'<details class="card"><summary>Effective configuration</summary><pre>{escape(config_yaml)}</pre></details>',
    ]
    return html_page(title, body, script=True)


def _title(summary: dict[str, Any]) -> str:
    log = summary.get("log")
    path = log.get("path", log.get("name")) if isinstance(log, dict) else log
    return str(path).replace("\\", "/").rsplit("/", 1)[-1] if path else "mfslam run"


def _subtitle(summary: dict[str, Any]) -> str:
    log = summary.get("log")
    kind = f"{log['format']} log, " if isinstance(log, dict) and "format" in log else ""
    return f"{kind}mapped by mfslam; every beam drawn from the robot's pose at its own instant"


def _tiles(summary: dict[str, Any]) -> str:
    counts, distances, grid = summary["counts"], summary["distances"], summary["map"]
    tiles = [
        ("distance_travelled", value_text("travelled_m", distances["travelled_m"])),
        ("length_of_log", value_text("log_duration_s", distances["log_duration_s"])),
        ("scans", value_text("scans", counts["scans"])),
        ("keyframes", value_text("keyframes", counts["keyframes"])),
        ("loops_in_use", value_text("count", summary["loops"]["in_use"])),
        ("map", f"{grid['width_m']:.0f} × {grid['height_m']:.0f} m"),
    ]
    if isinstance(summary.get("real_time_factor"), (int, float)):
        tiles.append(("times_real_time", f"{summary['real_time_factor']:.3g} ×"))
    cells = "".join(
        f'<div class="tile"><b>{escape(v)}</b><span>{escape(caption(k))}</span></div>' for k, v in tiles
    )
    return f'<div class="tiles">{cells}</div>'


def _warnings(result: RunResult, summary: dict[str, Any]) -> str:
    lines = result.findings.lines()
    if summary.get("interrupted"):
        lines.insert(0, "The run was interrupted: this is the part of the log mapped until then.")
    if not lines:
        return '<h2>Warnings</h2><p class="clean">None: nothing in this log looked odd.</p>'
    items = "".join(f"<li>{escape(line)}</li>" for line in lines)
    return f'<h2>Warnings</h2><ul class="warnings">{items}</ul>'


def _map(result: RunResult, summary: dict[str, Any]) -> str:
    layers, box = map_layers(result, _jumps(summary, len(result.stamps_ns)))
    boxes = "".join(
        f'<label><input type="checkbox" value="{layer.key}"{" checked" if layer.shown else ""}>'
        f'<i class="k-{layer.key}"></i>{escape(layer.name)}</label>'
        for layer in layers
    )
    drawing = "".join(layer.svg for layer in layers)
    view_box = " ".join(f"{value:.2f}" for value in box.tolist())
    shape = f"aspect-ratio: {box[2]:.2f} / {box[3]:.2f}"
    return (
        f'<h2>Map</h2><div class="card map"><div class="bar">{boxes}<button id="whole">whole map</button></div>'
        f'<div class="sheet"><svg id="map" viewBox="{view_box}" style="{shape}" role="img" '
        f'aria-label="map with trajectory">{drawing}</svg><div id="scale"></div><div id="where">wheel zooms, drag moves</div></div></div>'
        '<p class="none">Green dot: start, red dot: end. Open direction: scan matching left more than '
        f"{OPEN_SIGMA_M:g} m (one sigma) open along the bar, so wheels or inertia decided there. Uncertainty: where the "
        "robot was with 95 % probability, seen from the start; the farther from it, the more a heading error moves.</p>"
    )


def _calibration(summary: dict[str, Any]) -> str:
    calibration = summary.get("calibration")
    if not isinstance(calibration, dict):
        return ""
    return f'<h2>Calibration</h2><div class="grid3">{calibration_cards(calibration)}</div>'


def _jumps(summary: dict[str, Any], scans: int) -> IntArray:
    """Scans at which the summary tells of an odometry anomaly."""
    anomalies = summary.get("odometry_anomalies")
    told = [a.get("scan") for a in anomalies if isinstance(a, dict)] if isinstance(anomalies, list) else []
    return np.array([n for n in told if isinstance(n, int) and 0 <= n < scans], dtype=np.int64)
