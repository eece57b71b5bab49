"""Notice scan stamps that repeat or run backwards. The log's order is kept: stamps may lie."""

from __future__ import annotations

from mfslam.types import Findings


class StampWatch:
    """Counts oddities between the stamps of consecutive scans."""

    def __init__(self, findings: Findings) -> None:
        self._findings = findings
        self._last_ns: int | None = None

    def see(self, stamp_ns: int, where: str) -> None:
        if self._last_ns is not None and stamp_ns <= self._last_ns:
            if stamp_ns == self._last_ns:
                self._findings.add("stamp-repeated", "scan has the stamp of the scan before it: kept", where)
            else:
                self._findings.add(
                    "stamp-backwards", "scan stamp is earlier than the one before: kept in log order", where
                )
        self._last_ns = stamp_ns
