"""Map and calibrate by turns, until nothing changes that matters: what is found depends on the deskewing, and that on it.
Then once more on the adjusted trajectory."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from mfslam.calibration.outcome import Calibration
from mfslam.calibration.run import calibrate
from mfslam.calibration.settings import applied
from mfslam.config import Config
from mfslam.slam import Slam, Solution

PASSES, MOST_PASSES = 3, 5  # that which found something wired wrong is not counted
# Of wheels that may be wrongly calibrated, on a mount that may be elsewhere: the laser's motions must not lean on them.
LOOSE = {
    "sigma_translation_per_m": 0.3,
    "sigma_lateral_per_m": 0.5,
    "sigma_rotation_per_rad": 0.5,
    "sigma_rotation_per_m": 0.1,
    "sigma_floor_m": 0.05,
    "sigma_floor_rad": 0.02,
}
Mapped = Callable[[Config], tuple[Slam, Solution]]


def for_motions(config: Config) -> Config:
    """The config for a run of which only the laser's motions are wanted, from scan to scan: without loops and without
    adjusting the whole."""

    def with_values(stage: str, **values: Any) -> dict[str, Any]:
        return {stage: getattr(config, stage).model_copy(update=values)}

    odometry, coarse = config.odometry, Config()
    return config.model_copy(
        update=with_values("imu", gyro_sigma_rad_per_sqrt_s=0.1, bias_sigma_rad_s=0.1)
        | with_values("loops", use=False)
        | with_values("refine", passes=0, localise=True, other_passes=0)
        | with_values("icp", point_spacing_m=max(config.icp.point_spacing_m, coarse.icp.point_spacing_m))
        | with_values(
            "frontend",
            keyframe_distance_m=max(config.frontend.keyframe_distance_m, coarse.frontend.keyframe_distance_m),
        )
        | with_values("odometry", **{key: max(getattr(odometry, key), least) for key, least in LOOSE.items()})
    )


def calibrate_by_turns(
    mapped: Mapped, config: Config, cut_short: Callable[[], bool], tell: Callable[[str], None]
) -> Calibration | None:
    """What a log says of its robot, seen from ``config``; None where it says too little.

    ``mapped``: a run over the log with a config. ``cut_short``: whether the user wants no further pass.
    """
    first = latest = None
    assumed = config
    blind = False  # whether the wheels spoilt a pass: then it is made by the scans alone
    counted = 0
    for _ in range(MOST_PASSES):
        found = calibrate(*mapped(for_motions(_without_wheels(config) if blind else config)))
        if found is None and latest is None and not blind and not cut_short():
            blind = True
            tell("the wheels do not fit what the laser sees: again by the scans alone")
            continue
        if found is None:
            break
        latest, first = found, first or found
        counted += not found.oddities
        if cut_short() or counted == PASSES or not found.changes:
            break
        # by what it is surely other than at first: a period that is nearly right by now is still followed, as delays need it
        config, blind = applied(assumed, found.since(first)), False
    if latest is None or first is None:
        return None
    if not cut_short():
        tell("refining the calibration on the adjusted trajectory")
        latest = calibrate(*mapped(applied(assumed, latest.since(first)))) or latest
    return latest.since(first)


def _without_wheels(config: Config) -> Config:
    return config.model_copy(update={"odometry": config.odometry.model_copy(update={"use": False})})
