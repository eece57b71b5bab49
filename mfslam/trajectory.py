"""The robot's pose at any scan and any instant, once the keyframes stand."""

from __future__ import annotations

import numpy as np

from mfslam import se2
from mfslam.config import OdometryConfig
from mfslam.types import BoolArray, FloatArray, IntArray

LEAST_STEP_M, LEAST_STEP_RAD = 0.05, 0.05  # that a match may be off


def spread_corrections(
    local_T_body: FloatArray,
    keyframes: IntArray,
    world_T_keyframe: FloatArray,
    torn: BoolArray | None = None,
) -> FloatArray:
    """(S, 3) world pose of every scan from its locally consistent one.

    ``local_T_body`` (S, 3): the front end's poses; ``keyframes`` (K,): indices of scans whose world poses
    are known. Between two keyframes the front end's motion is kept and what the graph changed about it
    is spread evenly over the scans. ``torn`` (K,): keyframes before which the front end's motion is not known;
    the scans before them hold to the keyframe that they follow.
    """
    scans = np.arange(len(local_T_body))
    segment = np.clip(np.searchsorted(keyframes, scans, side="right") - 1, 0, len(keyframes) - 1)
    following = np.minimum(segment + 1, len(keyframes) - 1)
    local_T_keyframe = local_T_body[keyframes]
    world_T_body = se2.compose(
        world_T_keyframe[segment], se2.between(local_T_keyframe[segment], local_T_body)
    )
    correction = se2.log(
        se2.between(
            se2.between(local_T_keyframe[segment], local_T_keyframe[following]),
            se2.between(world_T_keyframe[segment], world_T_keyframe[following]),
        )
    )
    span = np.maximum(keyframes[following] - keyframes[segment], 1)
    share = np.where(following > segment, (scans - keyframes[segment]) / span, 0.0)
    if torn is not None:
        share[torn[following]] = 0.0
    return se2.compose(world_T_body, se2.exp(correction * share[:, None]))


def spread_covariances(
    covariances: FloatArray, steps: FloatArray, world_T_body: FloatArray, keyframes: IntArray
) -> FloatArray:
    """(S, 3, 3) covariance of every scan's x, y and yaw, in the world's axes, from those of the keyframes.

    ``covariances`` (K, 3, 3): in the tangents of the keyframes; ``steps`` (K - 1, 3, 3): of the motion from each to
    the next as measured; ``world_T_body`` (S, 3). A scan between two keyframes is as sure as they are, each
    carried to it, by its share of the way; in the middle of a step it is less sure than at its ends, as a bridge
    between them is (share (1 - share) of the step's covariance).
    """
    scans = np.arange(len(world_T_body))
    segment = np.clip(np.searchsorted(keyframes, scans, side="right") - 1, 0, len(keyframes) - 1)
    following = np.minimum(segment + 1, len(keyframes) - 1)
    span = np.maximum(keyframes[following] - keyframes[segment], 1)
    share = np.where(following > segment, (scans - keyframes[segment]) / span, 0.0)[:, None, None]

    def carried(which: IntArray) -> FloatArray:
        adjoint = se2.adjoint(se2.between(world_T_body, world_T_body[keyframes[which]]))
        return np.asarray(adjoint @ covariances[which] @ np.swapaxes(adjoint, 1, 2))

    out = (1.0 - share) * carried(segment) + share * carried(following)
    if len(steps):
        out += share * (1.0 - share) * steps[np.minimum(segment, len(steps) - 1)]
    turn = np.zeros((len(scans), 3, 3))
    turn[:, 0, 0] = turn[:, 1, 1] = np.cos(world_T_body[:, 2])
    turn[:, 1, 0] = np.sin(world_T_body[:, 2])
    turn[:, 0, 1] = -turn[:, 1, 0]
    turn[:, 2, 2] = 1.0
    return np.asarray(turn @ out @ np.swapaxes(turn, 1, 2))


def poses_at(times_s: FloatArray, world_T_body: FloatArray, at_s: FloatArray) -> FloatArray:
    """(N, 3) poses at instants ``at_s``, constant twist between knots (eq. 16 made exact), held at both
    ends. ``times_s`` (S,) must not decrease."""
    after = np.clip(np.searchsorted(times_s, at_s, side="right"), 1, max(1, len(times_s) - 1))
    if len(times_s) == 1:
        return np.repeat(world_T_body, len(at_s), axis=0)
    t0, t1 = times_s[after - 1], times_s[after]
    share = np.clip((at_s - t0) / np.where(t1 > t0, t1 - t0, 1.0), 0.0, 1.0)
    return se2.interpolate(world_T_body[after - 1], world_T_body[after], share)


def twists_over(
    times_s: FloatArray, world_T_body: FloatArray, starts_s: FloatArray, ends_s: FloatArray, window_s: float
) -> FloatArray:
    """(N, 3) mean body twists over intervals, each widened about its middle to at least ``window_s``."""
    middle = 0.5 * (starts_s + ends_s)
    half = 0.5 * np.maximum(ends_s - starts_s, window_s)
    t0 = np.clip(middle - half, times_s[0], times_s[-1])
    t1 = np.clip(middle + half, times_s[0], times_s[-1])
    motion = se2.log(se2.between(poses_at(times_s, world_T_body, t0), poses_at(times_s, world_T_body, t1)))
    span = (t1 - t0)[:, None]
    return np.where(span > 1e-3, motion / np.maximum(span, 1e-3), 0.0)


def faster_than_driven(times_s: FloatArray, world_T_body: FloatArray, config: OdometryConfig) -> BoolArray:
    """(S - 1,) steps from pose to pose (S, 3) that no robot drives in the time between (S,): stamps that lie."""
    moved, dt_s = se2.between(world_T_body[:-1], world_T_body[1:]), np.diff(times_s)
    too_far = np.hypot(moved[:, 0], moved[:, 1]) > config.max_speed_m_s * dt_s + LEAST_STEP_M
    turned = np.abs(moved[:, 2]) > config.max_yaw_rate_rad_s * dt_s + LEAST_STEP_RAD
    return np.asarray(too_far | turned)
