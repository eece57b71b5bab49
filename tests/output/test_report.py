"""The report is one file that needs nothing else, and says what happened."""

from __future__ import annotations

import re
from html.parser import HTMLParser

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mfslam.output import charts, summarise
from mfslam.output.overlay import ellipse_scale, map_layers
from mfslam.output.report import report_html
from mfslam.output.tables import caption, section_tables, value_text
from mfslam.settings import describe
from mfslam.types import RunResult

VOID = {"meta", "input", "br"}


class Balance(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.links: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.links += [value or "" for key, value in attrs if key in ("src", "href")]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.links += [value or "" for key, value in attrs if key in ("src", "href")]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


@pytest.fixture
def page(result: RunResult) -> str:
    return report_html(result, summarise(result), describe())


def test_well_formed_and_self_contained(page: str) -> None:
    parser = Balance()
    parser.feed(page)
    assert parser.open == []
    assert parser.links and all(link.startswith("data:image/png;base64,") for link in parser.links)
    assert not re.search(r"https?://|@import|url\(", page)
    assert "nan" not in re.sub(r"base64,[^\"]*", "", page)


def test_warnings_in_words(page: str, result: RunResult) -> None:
    assert result.findings.lines()[0] in page
    assert "stamps go backwards" in page


def test_names_from_a_log_cannot_inject_markup(result: RunResult) -> None:
    result.summary["log"] = {"path": "<script>alert(1)</script>.clf", "format": "<b>"}
    result.findings.add("odd", "topic <img src=x>", "<i>")
    page = report_html(result, summarise(result), "# <u>")
    for markup in ("<script>alert", "<b>,", "<img", "<i>)", "# <u>"):
        assert markup not in page


def test_open_stretches_are_drawn_and_listed(page: str, result: RunResult) -> None:
    stretch = result.open_stretches[0]
    told = summarise(result)["open_stretches"][0]
    assert told["travelled_m"] == stretch.travelled_m and told["open_direction_deg"] == 0.0
    assert told["to_stamp_s"] > told["from_stamp_s"]
    assert "open direction (1)" in page and "Open stretches" in page


def test_ellipses_are_as_large_as_the_covariance_says(result: RunResult) -> None:
    layers, box = map_layers(result, np.zeros(0, np.int64))
    ellipses = next(layer for layer in layers if layer.key == "ellipses")
    scale = ellipse_scale(result.covariances, float(box[2:].max()))
    assert f"{scale} times as large" in ellipses.name
    outlines = re.findall(r"M([^MZ]*)Z", ellipses.svg)
    corners = np.array([[float(v) for v in point.split()] for point in outlines[-1].split("L")])
    # near the end of the path the sigmas are 2 and 5 cm
    half = 0.5 * np.ptp(corners, axis=0) / scale
    assert half == pytest.approx([2.448 * 0.02, 2.448 * 0.05], rel=0.05)


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=8,
)


@given(json_values)
def test_whatever_a_summary_holds_is_shown(value: object) -> None:
    parser = Balance()
    parser.feed(section_tables({"extra": value, "odometry_anomalies": [], "nested": {"inner": value}}))
    assert parser.open == []


def test_quantiles_over_stretches() -> None:
    x = np.arange(1000.0)
    _, low, middle, high = charts.binned(x, np.tile(np.arange(100.0), 10), bins=10)
    np.testing.assert_allclose([low[0], middle[0], high[0]], [5, 50, 94], atol=1.0)
    assert len(middle) == 10


@pytest.mark.parametrize(("top", "expected"), [(1.0, [0, 0.2, 0.4, 0.6, 0.8, 1.0]), (37.0, [0, 10, 20, 30])])
def test_ticks_are_round(top: float, expected: list[float]) -> None:
    np.testing.assert_allclose(charts.ticks(top), expected)


@pytest.mark.parametrize(
    ("key", "value", "text"),
    [
        ("travelled_m", 508.2, "508.2 m"),
        ("log_duration_s", 2691.0, "44 min 51 s"),
        ("log_duration_s", 7677.0, "2 h 07 min"),
        ("turned_deg", 12345.6, "12,346°"),
        ("scans", 13631, "13,631"),
        ("stamp_ns", 976052857000000123, "976052857000000123 ns"),
        ("gyro", None, "-"),
        ("converged", True, "yes"),
    ],
)
def test_values_read_as_people_write_them(key: str, value: object, text: str) -> None:
    assert value_text(key, value) == text


def test_captions_drop_the_unit() -> None:
    assert caption("residual_median_deg") == "residual median"
