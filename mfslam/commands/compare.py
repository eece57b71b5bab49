"""`mfslam compare`: what changed between two runs."""

from __future__ import annotations

import argparse
import base64
import io
from html import escape
from typing import Any

from mfslam.evaluation.page import card, colour, path_picture, table_card
from mfslam.evaluation.runs import Comparison, compare_runs, read_run
from mfslam.evaluation.tables import Rows, as_text, shown
from mfslam.output import check_outputs, json_text, write_atomically
from mfslam.output.charts import Series, binned, line_chart
from mfslam.output.page import html_page
from mfslam.output.tables import caption, unit_of, value_text


def run(args: argparse.Namespace) -> int:
    check_outputs(args.output, args.json, args.picture)
    comparison = compare_runs(read_run(args.a), read_run(args.b))
    tables = _tables(comparison.data)
    if args.json is not None:
        write_atomically(args.json, json_text(comparison.data).encode())
    png = _png(comparison)
    if args.picture is not None:
        write_atomically(args.picture, png)
    if args.output is not None:
        write_atomically(args.output, _page(comparison, tables, png).encode())
    if not args.quiet:
        print("\n\n".join(f"{title}\n{as_text(rows)}" for title, rows in tables))
        for path in (args.output, args.picture):
            if path is not None:
                print(f"written  {path}")
    return 0


def _tables(data: dict[str, Any]) -> list[tuple[str, Rows]]:
    a, b = shown(data["a"]), shown(data["b"])
    poses, maps, loops = data["trajectories"], data["maps"], data["loops"]
    apart: Rows = [["", "mean", "median", "99 %", "max"]]
    for title, key in (("best alignment", "aligned"), ("as they are", "as_they_are")):
        for unit, part in (("m", "translation_m"), ("deg", "rotation_deg")):
            s = poses[key][part]
            apart.append(
                [f"{title}, {unit}", *(f"{s[name]:.4f}" for name in ("mean", "median", "p99", "max"))]
            )
    counts: Rows = [
        ["", a, b, "common"],
        ["poses", f"{poses['poses_a']:,}", f"{poses['poses_b']:,}", f"{poses['common']:,}"],
        ["loops and far matches", f"{loops['a']:,}", f"{loops['b']:,}", f"{loops['common']:,}"],
        ["cells of walls", f"{maps['walls_a']:,}", f"{maps['walls_b']:,}", "-"],
        ["share of them in the other map", f"{maps['shared_of_a']:.1%}", f"{maps['shared_of_b']:.1%}", "-"],
    ]
    numbers: Rows = [["", a, b, "change"]]
    for key, row in data["summary"].items():
        share = f"{100.0 * row['change'] / row['a']:+.1f} %" if row["a"] else f"{row['change']:+.4g}"
        parts = key.split(".")
        unit = unit_of(parts[-1]) or unit_of(parts[0])  # timings_s.map
        name = " ".join(caption(part) for part in parts) + (f", {unit}" if unit else "")
        values = (value_text(key, row[run], show_unit=False) for run in ("a", "b"))
        numbers.append([name, *values, share if row["change"] else "same"])
    return [("Poses of one instant, apart", apart), ("What both have", counts), ("Summaries", numbers)]


def _png(comparison: Comparison) -> bytes:
    from PIL import Image

    out = io.BytesIO()
    Image.fromarray(comparison.picture).save(out, format="PNG", optimize=True)
    return out.getvalue()


def _page(comparison: Comparison, tables: list[tuple[str, Rows]], png: bytes) -> str:
    a, b = shown(comparison.data["a"]), shown(comparison.data["b"])
    over = []
    for unit, values in (("m", comparison.apart_m), ("deg", comparison.apart_deg)):
        x, low, middle, high = binned(comparison.seconds, values, 120)
        chart = line_chart([Series(unit, colour(0), x, middle, low, high)], "time (s)", f"apart ({unit})")
        over.append(
            card(f"How far apart ({unit})", "Median, and 5 to 95 %, after the best alignment.", chart)
        )
    picture = (
        f'<img style="width:100%;image-rendering:pixelated;background:#fff" alt="difference of the maps" '
        f'src="data:image/png;base64,{base64.b64encode(png).decode()}">'
    )
    paths = path_picture([(a, colour(0), comparison.a_path), (b, colour(1), comparison.b_path)])
    note = (
        f"Dark: walls of both. Red: of {a} alone. Blue: of {b} alone. A wall one cell away is the same wall."
    )
    body = [
        f"<header><h1>{escape(a)} and {escape(b)}</h1><p>two runs side by side, by mfslam compare</p></header>",
        f"<h2>Maps</h2>{card('Difference', note, picture)}",
        f"<h2>Trajectories</h2>{card('Paths', 'The second one aligned with the first.', paths)}",
        f'<div class="grid2">{"".join(over)}</div>',
        f"<h2>In numbers</h2>{''.join(table_card(title, rows) for title, rows in tables)}",
    ]
    return html_page(f"{a} and {b}", body)
