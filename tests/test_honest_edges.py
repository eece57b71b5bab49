"""What edges of the second pass say of their own error: closed forms, and ray-cast scans with exact truth."""

from __future__ import annotations

import numpy as np
import pytest

from mfslam import refine, se2
from mfslam.config import Config
from mfslam.deskew import acceleration_lever_s2, deskew
from mfslam.graph import GraphInformation
from mfslam.types import Edge, Scan
from tests.rooms import ROOM, ROOM_PILLARS, cast, laser

OWN = np.diag([1e4, 1e4, 1e5])


def edge(i: int, j: int, information=OWN) -> Edge:
    return Edge("scan", i, j, np.zeros(3), information)


def test_edges_of_a_chain_share_nothing():
    assert [e.shared for e in refine.with_shared_noise([edge(k, k + 1) for k in range(5)])] == [1.0] * 5


@pytest.mark.parametrize("count", [4, 12])
def test_scans_that_are_all_matched_with_each_other_are_no_surer_than_one_match(count):
    """Poses i and j are known relative to each other as one match of the two tells it, whatever is added."""
    pairs = [(i, j) for j in range(count) for i in range(j)]
    edges = refine.with_shared_noise([edge(i, j) for i, j in pairs])
    assert {e.shared for e in edges} == {0.5 * (count - 1)}
    assert [e.information[0, 0] for e in edges] == [1e4] * len(edges)  # of itself each says what it said
    covariance = GraphInformation(np.zeros((count, 3)), edges).marginals()[1]
    np.testing.assert_allclose(covariance, np.linalg.inv(OWN) * (count - 1) / count, rtol=1e-6)


def test_motion_errors_of_both_scans_add_up_in_the_frame_of_the_second():
    variances = np.array([[4e-4, 1e-4, 0.0], [0.0, 0.0, 9e-6]])
    turned = Edge("scan", 0, 1, np.array([0.0, 0.0, 0.5 * np.pi]), OWN)
    (wider,) = refine.with_motion_errors([turned], variances)
    expected = np.linalg.inv(OWN) + np.diag([1e-4, 4e-4, 9e-6])  # x of the first is y of the second
    np.testing.assert_allclose(np.linalg.inv(wider.information), expected, atol=1e-12)


def test_an_open_direction_stays_open():
    bare = Edge("scan", 0, 1, np.zeros(3), np.diag([0.0, 1e4, 1e5]))
    (wider,) = refine.with_motion_errors([bare], np.full((2, 3), 1e-4))
    assert wider.information[0, 0] == 0.0 and 0.0 < wider.information[1, 1] < 1e4


def test_an_acceleration_acts_by_a_twelfth_of_the_duration_squared():
    model = laser(n_beams=2000, turn_s=0.1)
    assert acceleration_lever_s2(model) == pytest.approx(0.1**2 / 12.0, rel=1e-3)
    centred = laser(n_beams=2000, turn_s=0.1)
    centred.offsets_s[:] -= 0.05
    assert acceleration_lever_s2(centred) == pytest.approx(0.1**2 / 24.0, rel=1e-2)


def test_errors_of_matches_are_as_large_as_their_covariances_say():
    """Pairs of noisy scans of a robot at rest, somewhere in the room: the mean chi2 per degree of freedom is near 1.

    It is below: range noise acts across a wall by the cosine of its incidence only, which the model leaves out.
    """
    config, model, rng = Config(), laser(n_beams=360), np.random.default_rng(2)
    chi2 = []
    for _ in range(60):
        first = np.array([rng.uniform(-2, 2), rng.uniform(-1, 2), rng.uniform(-3, 3)])
        poses = np.stack([first, se2.compose(first, rng.normal(0.0, [0.2, 0.1, 0.1]))])
        clouds = []
        for pose in poses:
            ranges = cast(ROOM, ROOM_PILLARS, pose, model) + rng.normal(0.0, model.range_sigma_m, 360)
            scan = Scan(0, ranges.astype(np.float32), model)
            clouds.append(deskew(scan, np.zeros(3), config.deskew, config.icp.point_spacing_m))
        (match,) = refine.match_neighbours(
            clouds, poses, [(0, 1)], model.range_sigma_m, config.icp, config.refine
        )
        error = se2.log(se2.between(match.i_T_j, se2.between(*poses)))
        chi2.append(error @ match.information @ error / 3.0)
    assert 0.5 < np.mean(chi2) < 1.2
