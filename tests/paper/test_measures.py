"""What the page's figures are measured with: errors in a scan, of a map, of ICP by iteration."""

from __future__ import annotations

import numpy as np
import pytest
from paper.convergence import CONVENTIONAL, GUESSES, METHODS, MOTION_FREE, converge, iterate, pairs_of
from paper.displacement import ErrorFigures, displacements, mean_by_beam, steady_scans
from paper.map_error import MapPoints, map_error, wall_cells
from paper.rig import SQUARE, Drive, drive_through, rms, true_twists

from mfslam import se2
from mfslam.config import DeskewConfig
from mfslam.deskew import beam_times_s


@pytest.fixture(scope="module")
def drive() -> Drive:
    """Standing, then along the first side of the square aisle at 1 m/s."""
    return drive_through(SQUARE, 10.0)


def test_snapshot_lags_by_the_way_driven_until_the_beam(drive: Drive) -> None:
    moved = displacements(drive, true_twists(drive), DeskewConfig(mode="none"))[steady_scans(drive, 1.0)]
    mean = mean_by_beam(moved)
    known = np.isfinite(mean[:, 0])
    assert known.sum() > 300
    np.testing.assert_allclose(mean[known, 0], -beam_times_s(drive.laser.laser)[known], atol=1e-4)
    np.testing.assert_allclose(mean[known, 1], 0.0, atol=1e-4)


def test_range_variant_is_off_by_one_minus_cosine_and_sine(drive: Drive) -> None:
    moved = displacements(drive, true_twists(drive), DeskewConfig(mode="range"))[steady_scans(drive, 1.0)]
    mean = mean_by_beam(moved)
    known = np.isfinite(mean[:, 0])
    way = beam_times_s(drive.laser.laser)
    bearing = drive.laser.laser.angles_rad
    np.testing.assert_allclose(mean[known, 0], (way * (np.cos(bearing) - 1.0))[known], atol=1e-4)
    np.testing.assert_allclose(mean[known, 1], (way * np.sin(bearing))[known], atol=1e-4)


def test_pose_variant_with_the_true_motion_leaves_nothing(drive: Drive) -> None:
    moved = displacements(drive, true_twists(drive), DeskewConfig(mode="pose"))[steady_scans(drive, 1.0)]
    assert np.nanmax(np.abs(moved)) < 1e-3


def test_error_figures_of_known_displacements() -> None:
    moved = np.zeros((4, 2, 2))
    moved[:, 1, 0] = [0.1, 0.3, 0.1, 0.3]
    figures = ErrorFigures.of(moved)
    assert figures.last_x_m == pytest.approx(0.2)
    assert figures.systematic_rms_m == pytest.approx(0.2 / np.sqrt(2.0))
    assert figures.rms_m == pytest.approx(np.sqrt(0.2 / 8.0))
    assert figures.max_m == pytest.approx(0.3)


def _map(drive: Drive, poses: np.ndarray, range_error_m: float = 0.0) -> MapPoints:
    scans = drive.exact_scans(range(len(poses)))
    for scan in scans:
        scan.ranges_m[:] += np.float32(range_error_m)
    return MapPoints.of(scans, poses, true_twists(drive), DeskewConfig(mode="pose"))


def test_true_map_has_no_error_wherever_it_stands(drive: Drive) -> None:
    elsewhere = se2.compose(np.array([3.0, -1.0, 0.7]), drive.world_T_body)
    for poses in (drive.world_T_body, elsewhere):
        error = map_error(drive, _map(drive, poses))
        assert error.rms_m < 1e-3
        assert error.local_rms_m < 1e-3
        assert error.ate_m < 1e-9
        assert error.cells > 100


def test_stretched_map_is_wrong_as_a_whole_and_less_so_piece_by_piece(drive: Drive) -> None:
    stretched = drive.world_T_body.copy()
    stretched[:, 0] += 0.1 * (stretched[:, 0] - stretched[0, 0])
    error = map_error(drive, _map(drive, stretched))
    assert error.ate_m > 0.1
    assert error.rms_m > 1.2 * error.local_rms_m > 0.0


def test_ranges_too_long_move_every_wall_by_that_at_most(drive: Drive) -> None:
    error = map_error(drive, _map(drive, drive.world_T_body, range_error_m=0.03))
    assert 0.01 < error.rms_m < 0.03
    assert error.max_m == pytest.approx(0.03, abs=0.002)


def test_every_hit_but_those_of_pillars_lies_on_its_cell_of_wall(drive: Drive) -> None:
    walls = wall_cells(drive)
    met = walls.cell >= 0
    off = np.sum(walls.normal * (drive.hits_m - walls.start_m), axis=-1)[met]
    assert np.max(np.abs(off)) < 1e-9
    assert not met[~np.isfinite(drive.ranges_m)].any()
    assert met.sum() > 0.9 * np.isfinite(drive.ranges_m).sum()


def test_motion_free_icp_from_the_wheels_leaves_less_along_the_driving(drive: Drive) -> None:
    pairs = pairs_of(drive, 1, 10)
    conventional, motion_free = (converge(pairs, method, GUESSES[1]) for method in METHODS)
    # points refer to the middle of their scan: a snapshot lags by half of what it does from its first beam
    assert motion_free.x_m[-1] < 0.6 * conventional.x_m[-1]
    assert motion_free.pairs == len(pairs) > 3


def test_icp_by_single_iterations_starts_at_the_guess_and_moves(drive: Drive) -> None:
    pair = pairs_of(drive, 1, 10)[2]
    guess = np.array([0.05, 0.02, 0.01])
    for method in (CONVENTIONAL, MOTION_FREE):
        poses = iterate(pair, method, guess, 3)
        np.testing.assert_array_equal(poses[0], guess)
        steps = np.hypot(*np.diff([p[:2] for p in poses], axis=0).T)
        assert steps[0] > steps[-1] > 0.0


def test_rms_leaves_out_what_is_not_known() -> None:
    assert rms(np.array([3.0, np.nan, 4.0])) == pytest.approx(np.sqrt(12.5))
