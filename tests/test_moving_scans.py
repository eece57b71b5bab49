"""Pose and twist of one scan at once, from the distortion that its own motion left in it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mfslam import icp, se2
from mfslam.config import Config, DeskewConfig, IcpConfig
from mfslam.deskew import STILL, beam_times_s, deskew, reference_offset_s
from mfslam.frontend import Frontend
from mfslam.step_records import PredictedMotion
from tests.rooms import CORRIDOR, NO_PILLARS, ROOM, ROOM_PILLARS, laser, moving_scan, oriented_points

MODEL = laser(turn_s=0.1)
HARDLY_HELD = np.diag([1.0, 1.0, 1.0, 0.1, 0.1, 0.1])
START = np.array([0.3, -0.2, 0.4])


def registered(walls, pillars, start, twist, guess, information, mean_twist=STILL):
    """A scan taken at ``twist`` from ``start``, matched with the walls from a guess and with another twist
    assumed of it: pose and twist found."""
    reference = icp.reference_table(np.hstack(oriented_points(walls, pillars, np.zeros(3))))
    scan = moving_scan(walls, pillars, start, twist, MODEL)
    pose, found = guess, mean_twist
    for _ in range(3):
        cloud = deskew(scan, found, DeskewConfig())
        pose, change = icp.register_moving(
            reference, cloud, beam_times_s(MODEL)[cloud.beams], pose, guess, mean_twist - found, information, 0.01,
            IcpConfig(),
        )  # fmt: skip
        found = found + change
    return pose, found


@pytest.mark.parametrize("twist", [[1.0, 0.0, 0.0], [0.0, 0.0, 2.0], [2.0, 0.0, -1.5], [-0.5, 0.3, 1.0]])
def test_a_scan_tells_its_own_twist(twist):
    guess = se2.compose(START, np.array([0.05, -0.05, 0.05]))
    pose, found = registered(ROOM, ROOM_PILLARS, START, np.array(twist), guess, HARDLY_HELD)
    np.testing.assert_allclose(found, twist, atol=0.06)
    middle = se2.exp(reference_offset_s(MODEL) * np.array(twist))
    error = se2.between(se2.compose(START, middle), pose)
    assert math.hypot(error[0], error[1]) < 0.01
    assert abs(error[2]) < math.radians(0.3)


def test_along_a_corridor_the_prior_decides():
    """Bare walls tell the turn and the sideways motion of a scan but not the speed along them."""
    level = np.zeros(3)
    twist, assumed = np.array([1.5, 0.0, 1.0]), np.array([1.2, 0.0, 0.5])
    held = np.diag(np.array([0.03, 0.03, 0.03, 0.5, 0.5, 0.5]) ** -2.0)
    _, found = registered(CORRIDOR, NO_PILLARS, level, twist, level, held, assumed)
    assert found[0] == pytest.approx(assumed[0], abs=0.02)
    assert found[2] == pytest.approx(twist[2], abs=0.1)


def turning_drive(joint):
    """A robot without wheels that begins to turn at 8 rad/s^2; largest heading error of its front end."""
    config = Config()
    config = config.model_copy(update={"frontend": config.frontend.model_copy(update={"joint_twist": joint})})
    frontend, pose, worst_rad = Frontend(config), np.zeros(3), 0.0
    dt_s, rates = 0.1, [0.0, 0.0, 0.0, 0.8, 1.6, 2.4, 2.4, 2.4, 1.6, 0.8, 0.0, 0.0]
    for n, rate in enumerate(rates):
        twist = np.array([0.3, 0.0, rate])
        motion = PredictedMotion(se2.log(frontend.last_step) / dt_s, dt_s if n else 0.0)
        step = frontend.process(n, moving_scan(ROOM, ROOM_PILLARS, pose, twist, MODEL), motion)
        turned = pose[2] + reference_offset_s(MODEL) * rate  # at the scan's reference instant
        worst_rad = max(worst_rad, abs(float(se2.wrap(step.local_T_body[2] - turned))))
        pose = se2.compose(pose, se2.exp(dt_s * twist))
    return worst_rad


def test_a_turn_that_begins_within_a_scan_is_followed():
    assert turning_drive(joint=True) < math.radians(0.6)
    assert turning_drive(joint=True) < 0.5 * turning_drive(joint=False)
