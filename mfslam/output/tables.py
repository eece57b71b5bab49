"""A run's summary as tables, whatever it holds: names and units come from the keys (``travelled_m``)."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import Any

_UNITS = {
    "_deg_per_m": "°/m", "_percent": "%", "_m_s": "m/s", "_rad_s": "rad/s", "_m2": "m²", "_ns": "ns", "_mb": "MB", "_deg": "°", "_rad": "rad",
    "_m": "m", "_s": "s", "_hz": "Hz",
}  # fmt: skip
_ELSEWHERE = (
    "findings",
    "timings_s",
    "interrupted",
    "calibration",
)  # these have their own place in the report
_ROWS_SHOWN = 40


def caption(key: str) -> str:
    """``travelled_m`` -> ``travelled``."""
    name, _ = _split(key)
    return name.replace("_", " ").replace("-", " ")


def unit_of(key: str) -> str:
    """``travelled_m`` -> ``m``; nothing where the key names no unit."""
    return _split(key)[1]


def value_text(key: str, value: Any, show_unit: bool = True) -> str:
    """A value as a person reads it, with the unit that its key names."""
    unit = _split(key)[1]
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if unit == "s" and show_unit and isinstance(value, (int, float)) and value >= 120:
        minutes, seconds = divmod(round(value), 60)
        hours, minutes = divmod(minutes, 60)
        return f"{hours} h {minutes:02d} min" if hours else f"{minutes} min {seconds:02d} s"
    if isinstance(value, float):
        text = f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.4g}"
    elif isinstance(value, int):
        text = f"{value:,}" if unit != "ns" else str(value)
    elif isinstance(value, (list, tuple)):
        return ", ".join(value_text(key, item) for item in value) or "none"
    else:
        text = str(value)
    return f"{text} {unit}".replace(" °", "°") if unit and show_unit else text


def section_tables(summary: Mapping[str, Any]) -> str:
    """Every section of a summary as a card with a table; single values share the first one."""
    single = {key: value for key, value in summary.items() if not _is_section(value)}
    sections = {key: value for key, value in summary.items() if _is_section(value)}
    cards = [_card("run", single)] if any(key not in _ELSEWHERE for key in single) else []
    shown = [item for item in sections.items() if item[0] not in _ELSEWHERE and item[1]]
    cards += [_card(*item) for item in sorted(shown, key=lambda item: _is_matrix(item[1]))]  # wide ones last
    return "".join(cards)


def calibration_cards(calibration: Mapping[str, Any]) -> str:
    """What was assumed and what the log itself says, and how sharp the map is before and after."""
    cards = (
        [f'<p class="none">Left as assumed: {escape(calibration["left_alone"])}.</p>']
        if "left_alone" in calibration
        else []
    )
    if calibration.get("found"):
        columns = ("assumed", "found", "sigma", "unit", "significant", "would_show_it")
        rows = {
            name: {column: row.get(column) for column in columns if column in row}
            for name, row in calibration["found"].items()
        }
        used = {True: "used for this map", False: "refused: the map gets blunter with it"}
        title = used.get(calibration.get("used"), "nothing that differs enough to map again")  # type: ignore[arg-type]
        cards.append(_card(f"found by the log itself, {title}", rows))
    if calibration.get("range_errors"):
        ranges = calibration["range_errors"]
        each = zip(ranges["assumed_m"], ranges["found_m"], ranges["sigma_m"], strict=True)
        told = {
            f"{n * ranges['step_m']:g} m": dict(zip(("assumed_m", "found_m", "sigma_m"), of_one, strict=True))
            for n, of_one in enumerate(each)
        }
        cards.append(_card("ranges are told too large by", told))
    if calibration.get("sharpness"):
        cards.append(_card("how sharp the map is", calibration["sharpness"]))
    return "".join(cards)


def _split(key: str) -> tuple[str, str]:
    for suffix, unit in _UNITS.items():
        if key.endswith(suffix) and key != suffix:
            return key.removesuffix(suffix), unit
    return key, ""


def _is_section(value: Any) -> bool:
    return isinstance(value, Mapping) or (isinstance(value, list) and bool(value) and _is_matrix(value))


def _card(name: str, section: Any) -> str:
    wide = _is_matrix(section)
    table = _matrix(section) if wide else _pairs(section)
    return f'<div class="card{" span" if wide else ""}"><h3>{escape(caption(name).capitalize())}</h3>{table}</div>'


def _is_matrix(section: Any) -> bool:
    rows = section.values() if isinstance(section, Mapping) else section
    return all(isinstance(row, Mapping) for row in rows)


def _pairs(section: Mapping[str, Any]) -> str:
    rows = []
    for key, value in section.items():
        if key in _ELSEWHERE:
            continue
        if isinstance(value, Mapping):
            rows += [(f"{caption(key)}: {caption(str(k))}", value_text(str(k), v)) for k, v in value.items()]
        else:
            rows.append((caption(key), value_text(key, value)))
    cells = "".join(f"<tr><th>{escape(name)}</th><td>{escape(text)}</td></tr>" for name, text in rows)
    return f"<table>{cells}</table>"


def _matrix(section: Any) -> str:
    """Rows of one shape: a mapping of mappings (named rows) or a list of mappings."""
    named = isinstance(section, Mapping)
    rows = list(section.items()) if named else [(str(n + 1), row) for n, row in enumerate(section)]
    columns = list(dict.fromkeys(key for _, row in rows for key in row))
    head = "".join(f"<th>{escape(_heading(column))}</th>" for column in columns)
    body = "".join(
        f"<tr><th>{escape(caption(name))}</th>"
        + "".join(
            f"<td>{escape(value_text(column, row.get(column), show_unit=False))}</td>" for column in columns
        )
        + "</tr>"
        for name, row in rows[:_ROWS_SHOWN]
    )
    more = len(rows) - _ROWS_SHOWN
    rest = f'<p class="note">and {more} more, see summary.json</p>' if more > 0 else ""
    return f"<table><thead><tr><th></th>{head}</tr></thead>{body}</table>{rest}"


def _heading(column: str) -> str:
    unit = _split(column)[1]
    return f"{caption(column)} ({unit})" if unit else caption(column)
