"""Where walls end: what tells the way along a corridor whose walls are flat and whose far end is out of sight.

A door's jamb or a corner is seen by no point, but between two beams: one hits the wall, the next passes where it would go on. Ends
are told apart by where they are alone, so they are asked only for how far along a wall the robot is, within what it knows of that.
"""

from __future__ import annotations

import numpy as np

from mfslam import se2
from mfslam.config import DeskewConfig
from mfslam.deskew import beam_directions, beam_times_s, twist_through
from mfslam.kernels import ends as kernels
from mfslam.types import FloatArray, Scan

LEAST_ENDS = 2  # that must agree: one alone may be that of a door which swings
ALONG_COS = 0.9  # of a wall and the way, or of two walls, that go the same way
ACROSS_M = 0.15  # two ends this near, seen along the wall, are on one
SIGMA_M = 0.01  # of an end, beyond what its beams leave open
RIVAL_M, RIVAL_SHARE = 0.15, 0.75  # so many of the ends agreeing as well elsewhere make it ambiguous
GATE_SIGMAS = 3.0
NO_ENDS = np.zeros((0, 5))


def wall_ends(scan: Scan, body_twist: FloatArray, config: DeskewConfig) -> FloatArray:
    """(E, 5) ends that a scan sees, in the body frame at its reference instant: x, y, the unit vector along the wall out of
    it, one sigma along it."""
    laser = scan.laser
    ends: FloatArray = kernels.wall_ends(
        scan.ranges_m, beam_directions(laser), beam_times_s(laser), laser.body_T_laser, twist_through(body_twist, config),
        laser.range_min_m, laser.range_max_m, laser.range_sigma_m,
    )  # fmt: skip
    return ends


def placed(ends: FloatArray, frame_T_body: FloatArray) -> FloatArray:
    """Ends (E, 5) in another frame."""
    if not len(ends):  # where wheels tell, nobody asks for them
        return ends
    turn = np.array([0.0, 0.0, frame_T_body[2]])
    return np.hstack(
        [se2.transform(frame_T_body, ends[:, :2]), se2.transform(turn, ends[:, 2:4]), ends[:, 4:]]
    )


def along(ends: FloatArray, direction: FloatArray) -> FloatArray:
    """Those of walls that run along a direction (2,)."""
    return ends[np.abs(ends[:, 2:4] @ direction) > ALONG_COS]


def shift_along(
    seen: FloatArray, known: FloatArray, direction: FloatArray, within_m: float
) -> tuple[float, float] | None:
    """How far along a direction (2,) ends ``seen`` (E, 5) have to be moved to be those ``known`` (E', 5), and one sigma of that;
    None where too few agree, or as many do elsewhere."""
    off_m = known[None, :, :2] - seen[:, None, :2]
    shifts_m, across_m = off_m @ direction, off_m @ np.array([-direction[1], direction[0]])
    alike = seen[:, 2:4] @ known[:, 2:4].T > ALONG_COS
    alike &= (np.abs(across_m) < ACROSS_M) & (np.abs(shifts_m) < within_m)
    if not alike.any():
        return None
    variances = seen[:, 4:] ** 2 + known[:, 4] ** 2 + SIGMA_M**2
    # each end has a vote for every shift that brings it to one of those known
    asked = shifts_m[alike]
    off_sigmas2 = np.square(shifts_m - asked[:, None, None]) / variances
    votes = np.where(alike, np.exp(-0.5 * off_sigmas2), 0.0).max(axis=2).sum(axis=1)
    best = int(np.argmax(votes))
    if votes[np.abs(asked - asked[best]) > RIVAL_M].max(initial=0.0) > RIVAL_SHARE * votes[best]:
        return None
    weights = np.where(alike & (off_sigmas2[best] < GATE_SIGMAS**2), 1.0 / variances, 0.0)
    agreeing = weights.any(axis=1)
    if agreeing.sum() < LEAST_ENDS:
        return None
    weights, shifts_m = weights[agreeing], shifts_m[agreeing]
    own = weights.max(axis=1)  # the same end seen from many keyframes is known no better than once
    each_m = (weights * shifts_m).sum(axis=1) / weights.sum(axis=1)
    shift_m = float(own @ each_m / own.sum())
    scatter = float(own @ np.square(each_m - shift_m)) / max(1, len(own) - 1)
    return shift_m, float(np.sqrt(max(1.0, scatter) / own.sum()))
