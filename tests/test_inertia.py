"""Where a robot goes on to that nobody watches, in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from mfslam import se2
from mfslam.inertia import ACCELERATION_SIGMAS, UNEVEN_SIGMAS, Inertia

SURE = np.diag([1e8, 1e8, 1e8])
NOTHING = np.zeros((3, 3))
AHEAD = np.array([0.1, 0.0, 0.0])
DT_S = 0.1


def driven(inertia: Inertia, steps: int) -> Inertia:
    """A robot whose scans tell exactly that it drives AHEAD in every tenth of a second."""
    inertia.begin()
    for _ in range(steps):
        inertia.found(se2.log(se2.between(inertia.go_on(DT_S), AHEAD)), SURE)
    return inertia


def test_a_robot_goes_on_as_it_did() -> None:
    inertia = driven(Inertia(), 20)
    np.testing.assert_allclose(inertia.step, AHEAD, atol=1e-3)
    np.testing.assert_allclose(inertia.go_on(DT_S), AHEAD, atol=1e-3)
    np.testing.assert_allclose(inertia.go_on(5.0), 10.0 * AHEAD, atol=0.01)  # for a second


def test_one_step_is_as_unsure_as_stamps_and_acceleration() -> None:
    inertia = driven(Inertia(), 200)
    inertia.covariance = np.zeros((9, 9))
    inertia.covariance[6:, 6:] = np.diag((ACCELERATION_SIGMAS * DT_S**2) ** 2)
    inertia.go_on(DT_S)
    moved = 0.5 * ACCELERATION_SIGMAS * DT_S**2
    np.testing.assert_allclose(inertia.sigmas[:2], np.hypot(moved, UNEVEN_SIGMAS)[:2], rtol=0.01)


def test_what_is_not_seen_is_ever_less_sure_and_the_speed_as_wrong_as_the_place() -> None:
    """Nothing is seen along x for two seconds; then the robot is found 1 m ahead of where it was thought to stand."""
    inertia = Inertia()
    inertia.told(np.zeros(3), DT_S, np.full(3, 0.001))
    inertia.mark()
    across_only = np.diag([0.0, 1e6, 1e6])
    sigmas = []
    for _ in range(20):
        inertia.go_on(DT_S)
        inertia.found(np.zeros(3), across_only)
        sigmas.append(inertia.sigmas[0])
        inertia.unseen(np.zeros(3))
    assert np.all(np.diff(sigmas) > 0.0)
    assert 0.5 < sigmas[-1] < 0.5 * ACCELERATION_SIGMAS[0] * 2.0**2
    inertia.go_on(DT_S)
    inertia.found(np.array([1.0, 0.0, 0.0]), SURE)
    assert 0.4 < inertia.step[0] / DT_S < 1.5, "not the 10 m/s of one step"
    assert inertia.sigmas[0] < 0.01
    # what was unsure on the way stays told, though the pose is sure again
    assert inertia.unseen(np.array([1.0, 0.0, 0.0]))[0, 0] == pytest.approx(sigmas[-1] ** 2, rel=0.5)


def test_no_robot_is_faster_than_robots_are() -> None:
    inertia = driven(Inertia(), 3)
    for _ in range(3):
        inertia.go_on(60.0)
    assert inertia.covariance[3, 3] <= (3.0 * DT_S) ** 2 * 1.2
    assert np.linalg.eigvalsh(inertia.covariance)[0] > -1e-9


def test_where_a_scan_tells_nothing_nothing_is_learned() -> None:
    inertia = driven(Inertia(), 20)
    inertia.go_on(DT_S)
    before = inertia.covariance.copy()
    inertia.found(np.zeros(3), NOTHING)
    np.testing.assert_allclose(inertia.covariance, before, atol=1e-12)
    np.testing.assert_allclose(inertia.step, AHEAD, atol=1e-3)
