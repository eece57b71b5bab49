#!/usr/bin/env python3
"""How good the wheels alone are, before and after `mfslam calibrate`, on every log at hand.

Where a log has relations, the error of the wheels' dead reckoning against them; elsewhere its ATE against mfslam's own
trajectory of the log, in stretches, since dead reckoning of a whole log tells of one wrong turn only.

    scripts/odometry_only.py                                   # a table on the terminal
    scripts/odometry_only.py --markdown docs/benchmarks.md     # into the page
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from benchmarking.page import write_markdown
from benchmarking.runs import NO_LOG, find_logs, log_name, relations_beside

from drivers.logs import default_presets, open_log
from mfslam import se2
from mfslam.calibration.outcome import Calibration
from mfslam.calibration.passes import calibrate_by_turns
from mfslam.calibration.run import record_of
from mfslam.calibration.wheel_track import DifferentialDrive, PoseOdometry, WheelLaw, WheelTrack
from mfslam.config import Config
from mfslam.evaluation.tables import Rows, as_text
from mfslam.metrics import read_relations, relations_error
from mfslam.settings import load, preset_path
from mfslam.slam import Slam, Solution
from mfslam.types import FloatArray, MfslamError

ROOT = Path(__file__).resolve().parent.parent
DOCUMENTED = {"exp2": ["wheels.track_m=0.33", "sensor.transport_delay_s=0"]}
DOCUMENTED["exp3"] = DOCUMENTED["exp2"]
STRETCH_M = 10.0
MOUNT = ("mount_x", "mount_y", "mount_yaw")


def mapped(path: Path, config: Config) -> tuple[Slam, Solution]:
    slam = Slam(config)
    with open_log(path, config) as log:
        for message in log:
            slam.feed(message)
    return slam, slam.finish()


def reckoned(slam: Slam, solution: Solution, law: WheelLaw, values: FloatArray, late_s: float) -> FloatArray:
    """(S, 3) the body at every scan by the wheels alone: by every step as told, which the engine may have called a jump."""
    record = record_of(slam, solution)
    assert record is not None
    steps, told = record.told_steps, slam.motion.told_with_scans
    if record.with_scans:
        poses = np.array(told)
        steps = np.vstack([np.zeros((1, 3)), se2.between(poses[:-1], poses[1:])])
    track = WheelTrack(record.knots_s, steps, law)
    track.move(values)
    return track.at(record.times_s + late_s)


def laws(config: Config, found: Calibration, counts_wheels: bool) -> tuple[WheelLaw, FloatArray]:
    """The law of the wheels as ``config`` has them, and its values as found."""
    if not counts_wheels:  # nothing is written of these: what is sure counts
        sure = [found[name] for name in ("scale", "turn_scale", "drift")]
        return PoseOdometry(), np.array([e.value if e.significant else e.before for e in sure])
    values = {e.name: e.value for e in found.estimates}
    wheels = config.wheels
    nominal = (wheels.radius_left_m, wheels.radius_right_m, wheels.track_m)
    names = ("radius_left", "radius_right", "track")
    return DifferentialDrive(wheels.track_m, found.start.signs), np.array(
        [values[name] / before for name, before in zip(names, nominal, strict=True)]
    )


def mount_found(found: Calibration) -> FloatArray:
    """(3,) of the laser on the axle; what is not observable as assumed."""
    x, y, yaw = (e.value if e.observable else e.before for e in map(found.__getitem__, MOUNT))
    return np.array([x, y, np.radians(yaw)])


def stretch_error_m(reference: FloatArray, poses: FloatArray) -> float:
    """Mean error (m) at the end of stretches of so much driving, both begun at the same pose."""
    steps = se2.between(reference[:-1], reference[1:])
    way = np.concatenate([[0.0], np.cumsum(np.hypot(steps[:, 0], steps[:, 1]))])
    last = np.searchsorted(way, way + STRETCH_M)
    a = np.flatnonzero(last < len(way))[::5]
    off = se2.between(se2.between(reference[a], reference[last[a]]), se2.between(poses[a], poses[last[a]]))
    return float(np.mean(np.hypot(off[:, 0], off[:, 1])))


def row_of(path: Path) -> list[str]:
    name = log_name(path)
    config = load([preset_path(p) for p in default_presets(path)], DOCUMENTED.get(name, []))
    found = calibrate_by_turns(lambda c: mapped(path, c), config, lambda: False, lambda _: None)
    if found is None:
        return [name, "wheels do not speak of this robot, or too little motion", "-", "-", "-"]
    slam, solution = mapped(path, config)
    law, values = laws(config, found, slam.motion.counts_wheels)
    late = [e.value - e.before for e in found.estimates if e.name == "delay" and e.observable]
    before = reckoned(slam, solution, law, law.start, 0.0)
    # seen from the laser, the axle may be elsewhere than assumed
    axle_T_body = se2.compose(mount_found(found), se2.inverse(slam.scans[0].laser.body_T_laser))
    after = se2.compose(reckoned(slam, solution, law, values, late[0] if late else 0.0), axle_T_body)
    surely = ", ".join(e.name.replace("_", " ") for e in found.significant) or "nothing"
    if relations_beside(path).is_file():
        relations = read_relations(relations_beside(path))
        errors = [
            relations_error(solution.stamps_ns, poses, relations).as_json() for poses in (before, after)
        ]
        means = [f"{e['translation_m']['mean']:.3f} m / {e['rotation_deg']['mean']:.2f} deg" for e in errors]
        return [name, "relations, mean", *means, surely]
    errors_m = [stretch_error_m(solution.world_T_reference, poses) for poses in (before, after)]
    return [name, f"off after {STRETCH_M:g} m, mean", *(f"{e:.3f} m" for e in errors_m), surely]


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, default=ROOT.parent / "shared" / "data", help="folder of logs")
    parser.add_argument("--only", action="append", default=[], help="only logs whose name holds this")
    parser.add_argument("--markdown", type=Path, help="write the table into this page, between its markers")
    options = parser.parse_args()
    rows = []
    for path in find_logs(options.data, options.only):
        try:
            rows.append(row_of(path))
        except MfslamError as error:
            if NO_LOG in str(error):
                continue
            rows.append([log_name(path), str(error).splitlines()[0], "-", "-", "-"])
        print(*rows[-1], sep=" | ", flush=True)
    table: Rows = [["log", "wheels alone", "before", "after", "surely other than assumed"], *rows]
    print(as_text(table))
    if options.markdown:
        command = " ".join(["scripts/odometry_only.py", *sys.argv[1:]])
        write_markdown(options.markdown, [("Wheels alone", table)], command, "odometry-only")
    return 0


if __name__ == "__main__":
    sys.exit(main())
