"""What gives way when the machine is too slow: keyframes first, scans last; and it is told."""

from __future__ import annotations

from dataclasses import dataclass, field

from mfslam.types import Findings

THIN_AT_S, RELAX_AT_S = 5.0, 1.0  # by which the map is behind the robot
SPARSE_AT_S = 30.0  # then only every second scan goes into the map
STEP, MOST, STEP_EVERY_S = 1.5, 4.0, 2.0  # keyframe spacing: by how much, at most, how often
POSE_LATE_S = 0.5  # a pose that old is no use: the scans before the newest are not placed


@dataclass
class Pressure:
    """Decides by how far the map, and the pose, are behind. ``spacing``: of keyframes, 1 as configured."""

    findings: Findings
    spacing: float = 1.0
    thinned: int = 0  # keyframes that were not made
    not_placed: int = 0  # scans without a pose at once
    not_mapped: int = 0  # scans that the map misses
    _changed_s: float = field(default=-1e9)

    def watch(self, behind_s: float, now_s: float) -> bool:
        """``behind_s``: of the map at ``now_s``. Whether `spacing` has changed."""
        if now_s - self._changed_s < STEP_EVERY_S:
            return False
        before = self.spacing
        if behind_s > THIN_AT_S:
            self.spacing = min(MOST, self.spacing * STEP)
        elif behind_s < RELAX_AT_S:
            self.spacing = max(1.0, self.spacing / STEP)
        if self.spacing == before:
            return False
        self._changed_s = now_s
        if self.spacing > before:
            self.findings.add(
                "keyframes-thinned",
                "the machine is too slow for every keyframe: they are made farther apart while the map is behind",
                f"{behind_s:.1f} s behind, spacing x {self.spacing:.1f}",
            )
        return True

    def goes_to_map(self, number: int, behind_s: float) -> bool:
        """Whether a scan is worth the back end's time; the recording has it all the same."""
        if behind_s < SPARSE_AT_S or number % 2 == 0:
            return True
        self.not_mapped += 1
        self.findings.add(
            "scans-not-mapped",
            "the machine is too slow for every scan: while the map was far behind, only every second one went into it "
            "(a recording has them all)",
            f"{behind_s:.1f} s behind",
        )
        return False

    def left_out(self, late_s: float) -> None:
        """A scan whose pose nobody waits for any more."""
        self.not_placed += 1
        self.findings.add(
            "scans-not-placed",
            "the machine is too slow for a pose of every scan: those that waited were left to the map alone",
            f"{late_s:.2f} s late",
        )
