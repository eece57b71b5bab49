"""Beyond the paper: recorded logs with their odometry taken away."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path

from drivers.logs import default_presets, open_log
from mfslam.metrics import crispness, read_relations, relations_error
from mfslam.settings import load, preset_path
from mfslam.slam import Slam
from paper.map_error import MapPoints

CELL_M = 0.02
# what tells the motion through a scan
WHEELS, SNAPSHOTS = "wheels", "no wheels, snapshots"
JOINT_TWIST, CONSTANT_TWIST = "no wheels, joint twist", "no wheels, constant twist"
LOGS = ("urg04lx/exp2.dat.gz", "urg04lx/exp3.dat.gz", "freiburg/fr079.clf.gz", "freiburg/intel.clf.gz")


@dataclass
class LogOutcome:
    """One log mapped in one way. Mean errors of the relations where the whole log was mapped and has any; ``cells`` of 2 cm that all
    beams hit, and the entropy of the hits (nats)."""

    log: str
    variant: str
    scans: int
    cells: int
    entropy_nats: float
    relations_m: float | None = None
    relations_deg: float | None = None


def logs_folder() -> Path:
    """``../shared/data`` beside the checkout, or $MFSLAM_DATA, as the tests have it."""
    beside = Path(__file__).resolve().parents[3] / "shared" / "data"
    return Path(os.environ.get("MFSLAM_DATA", beside))


def logs_at_hand() -> list[Path]:
    """Those of the logs that are there."""
    return [path for path in (logs_folder() / name for name in LOGS) if path.is_file()]


def map_log(path: Path, variant: str, given: Iterable[str], max_scans: int | None = None) -> LogOutcome:
    """Map a recorded log, or its first scans, with its own presets and the settings ``given``."""
    config = load([preset_path(name) for name in default_presets(path)], given)
    slam = Slam(config)
    with open_log(path, config) as log:
        for message in takewhile(lambda m: max_scans is None or len(slam.scans) < max_scans, log):
            slam.feed(message)
    solution = slam.finish()
    poses = solution.world_T_reference
    points = MapPoints.of(slam.scans, poses, solution.twists, config.deskew)
    crisp = crispness(points.placed(poses), CELL_M)
    name = path.name.split(".")[0]
    outcome = LogOutcome(name, variant, len(slam.scans), crisp.cells, crisp.entropy_nats)
    truth = path.with_name(f"{name}.relations")
    if max_scans is None and truth.is_file():
        error = relations_error(solution.stamps_ns, solution.world_T_body, read_relations(truth))
        outcome.relations_m, outcome.relations_deg = error.translation_m.mean, error.rotation_deg.mean
    return outcome
