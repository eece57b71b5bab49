"""Recovery: where a robot can be whose scan does not fit where it was expected, and the search for it."""

from __future__ import annotations

import math

import numpy as np

from mfslam.config import FrontendConfig
from mfslam.kernels import poses
from mfslam.search import MAX_HYPOTHESES, SearchMap, hypotheses, search
from mfslam.types import FloatArray

# of a robot whose wheels are not known: ahead, sideways, turning (m/s^2, rad/s^2)
MAX_ACCELERATION = np.array([2.0, 0.5, 4.0])
REACH_SIGMAS = 3.0
LEAST_S = 0.3  # scans come in bursts and stamps lie: no time between two is held to be shorter
LEAST_PERIOD_S = 0.05  # nor a laser to be faster
BLIND_S = 0.5  # without wheels and without a fit for longer, the robot may be anywhere within its reach
COAST_S = 1.0  # a robot is not held to go on as it did for longer
NEAR_M, NEAR_RAD = 0.42, 0.6  # of a slip of wheels that else told the truth
NEAR_MARGIN, FAR_MARGIN = 0.08, 0.2  # by so much of its points a fit elsewhere has to be better
MIN_SCORE = 0.4


def free_motion_sigmas(dt_s: float) -> FloatArray:
    """One-sigma change (3,) of the next step of a robot that nobody watches: inertia bounds it."""
    return 0.02 + 0.5 * MAX_ACCELERATION * min(max(dt_s, 0.02), 2.0) ** 2


def reach(dt_s: float) -> tuple[float, float]:
    """How far (m, rad) a robot can be from where its inertia would have carried it."""
    half_m, _, half_rad = (REACH_SIGMAS * free_motion_sigmas(max(dt_s, LEAST_S))).tolist()
    return half_m, min(half_rad, math.pi)


def coasted(last_step: FloatArray, last_dt_s: float, dt_s: float) -> FloatArray:
    """The step (3,) of a robot that goes on as in its last one; a gap in the log makes it longer."""
    if dt_s <= LEAST_S:
        return last_step
    share = min(dt_s, COAST_S) / max(last_dt_s, LEAST_PERIOD_S)
    step: FloatArray = poses.advance(np.zeros(3), poses.log(last_step), max(1.0, share))
    return step


def is_likely(step: FloatArray, last_step: FloatArray, coasting: FloatArray, dt_s: float) -> bool:
    """Whether inertia allows a step (3,), be it counted by scans or by stamps, of which some lie."""
    half_m, half_rad = reach(dt_s)
    for expected in (last_step,) if coasting is last_step else (last_step, coasting):
        x, y, theta = poses.between(expected, step).tolist()
        if math.hypot(x, y) <= half_m and abs(theta) <= half_rad:
            return True
    return False


def place_near(
    recent: SearchMap, points_m: FloatArray, guess: FloatArray, config: FrontendConfig
) -> FloatArray | None:
    """The pose (3,) within a slip of wheels of ``guess`` at which the points look most like the recent map."""
    window = min(NEAR_M, config.search_window_m), min(NEAR_RAD, math.radians(config.search_angle_deg))
    found, score = search(recent, points_m, guess, *window, MIN_SCORE)
    return found if score > 0.0 else None


def places_within_reach(
    recent: SearchMap,
    points_m: FloatArray,
    center: FloatArray,
    within: tuple[float, float],
    config: FrontendConfig,
) -> list[FloatArray]:
    """Poses (3,) ``within`` reach (m, rad) of a center at which the points look like the recent map, the likeliest first;
    none where it looks like that all over the place."""
    half_m, half_rad = within
    window = min(half_m, config.search_window_m), min(half_rad, math.radians(config.search_angle_deg))
    found = hypotheses(recent, points_m, center, *window, MIN_SCORE)
    return [pose for pose, _ in found] if len(found) <= MAX_HYPOTHESES else []
