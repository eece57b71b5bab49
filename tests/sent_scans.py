"""What a simulated laser has sent over its line, against what was recorded of it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from mfslam.types import Scan


def sent_scans(path: Path) -> list[dict[str, Any]]:
    """The laser's scans as they went over the line, whole or not."""
    if not path.exists():
        return []
    lines = path.read_text(encoding="utf-8").split("\n")[:-1]  # the last one may be half written
    return [block for block in map(json.loads, lines) if block["line"] == "lidar" and "values" in block]


def sent_for_s(path: Path) -> float:
    """From the first scan that was sent to the latest."""
    sent = sent_scans(path)
    return float(sent[-1]["step_0_s"] - sent[0]["step_0_s"]) if sent else 0.0


def check_recorded(scans: Sequence[Scan], path: Path) -> tuple[int, int, int]:
    """Every scan that came over whole is there, but for what lay in the line when it was pulled, and nothing that
    was not sent. How many were sent, came over whole, and were recorded."""
    sent, recorded = sent_scans(path), {scan.ranges_m.tobytes() for scan in scans}
    whole = [block for block in sent if block["intact"]]
    begins = [block["step_0_s"] for block in sent]
    closed_s = [a for a, b in pairwise(begins) if b - a > 0.8]
    missed_s = [block["step_0_s"] for block in whole if _as_recorded(block) not in recorded]
    assert all(any(0.0 <= end_s - at_s < 1.0 for end_s in closed_s) for at_s in missed_s)
    all_sent = {_as_recorded(block) for block in sent}
    assert all(_differ_in_two(text, all_sent) for text in recorded - all_sent)
    return len(sent), len(whole), len(recorded)


def _differ_in_two(text: bytes, sent: set[bytes]) -> bool:
    """Whether it is one of those sent but for two bits: the six bits of a line's sum miss one such pair in twenty."""
    there = np.frombuffer(text, np.float32)
    same = (np.isclose(there, np.frombuffer(one, np.float32), equal_nan=True).sum() for one in sent)
    return any(there.size - count <= 2 for count in same)


def _as_recorded(block: dict[str, Any]) -> bytes:
    values = np.array(block["values"])
    metres = np.where(values < 20, np.nan, values * 1e-3).astype(np.float32)
    metres[metres >= np.float32(5.6)] = np.inf
    return metres.tobytes()
