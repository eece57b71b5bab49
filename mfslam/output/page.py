"""The frame of every HTML page that mfslam writes: one file that opens offline."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from importlib.resources import files


def html_page(title: str, body: Sequence[str], script: bool = False) -> str:
    """A whole page around ``body``; ``script``: with what a zoomable map needs."""
    home = files("mfslam.output")
    style = home.joinpath("report.css").read_text("utf-8")
    code = f"\n<script>\n{home.joinpath('report.js').read_text('utf-8')}</script>" if script else ""
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta name="color-scheme" content="light dark">\n'
        f"<title>{escape(title)} - mfslam</title>\n<style>\n{style}</style>\n</head>\n<body>\n<main>\n"
        + "\n".join(body)
        + f"\n</main>{code}\n</body>\n</html>\n"
    )
