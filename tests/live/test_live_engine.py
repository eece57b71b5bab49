"""The live engine through real processes: poses at once, the offline solution at the end, whatever dies on the way."""

from __future__ import annotations

import os
import signal
import time
from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
from short_logs import drive

from mfslam import se2
from mfslam.config import Config
from mfslam.live import pressure
from mfslam.live.engine import LiveSlam
from mfslam.live.journal import Journal
from mfslam.live.pressure import MOST, Pressure
from mfslam.live.tracking import Tracker
from mfslam.metrics import ate
from mfslam.slam import Slam
from mfslam.types import Findings, MfslamError, Scan

SCANS = 200


@pytest.fixture(scope="module")
def log():
    """The first scans of a drive, with the wheels between them, and the truth at the scans."""
    simulation = drive()
    at = [n for n, message in enumerate(simulation.messages) if isinstance(message, Scan)]
    return simulation.messages[: at[SCANS]], simulation.truth_world_T_body[:SCANS]


@pytest.fixture(scope="module")
def offline(log):
    slam = Slam(Config())
    for message in log[0]:
        slam.feed(message)
    return slam.finish()


def fed(slam, messages, stop=None):
    """Poses (S, 3) as they were told, with the log waiting for the map."""
    slam.may_thin = False
    poses = []
    for message in islice(messages, stop):
        pose = slam.feed(message)
        if pose is not None:
            poses.append(pose)
            slam.wait(20)
    slam.wait(1)
    return np.array(poses)


def share_on_walls(points_m, grid):
    """Share of hits with an occupied cell beside them."""
    cells = np.floor((points_m - grid.origin_m) / grid.resolution_m).astype(int)
    x, y = cells[np.all((cells >= 1) & (cells < np.array(grid.occupancy.shape)[::-1] - 1), axis=1)].T
    near = np.max([grid.occupancy[y + dy, x + dx] for dy in (-1, 0, 1) for dx in (-1, 0, 1)], axis=0)
    return np.sum(near > 50) / len(points_m)


def test_poses_come_at_once_and_the_end_is_that_of_the_offline_engine(log, offline, tmp_path):
    messages, truth = log
    with LiveSlam(Config(), tmp_path) as slam:
        poses = fed(slam, messages)
        state, world_T_local = slam.state(), slam.world_T_local
        grid = slam.map()
        keyframes, edges = slam.graph()
        finished = slam.finish(None, tmp_path / "drive", "simulated")
    assert len(poses) == SCANS
    assert ate(truth, poses).translation_m.rmse < 0.05
    assert np.array_equal(finished.world_T_body, offline.world_T_body)
    assert ate(truth, finished.online).translation_m.rmse < 0.03
    assert np.allclose(state.world_T_body, se2.compose(world_T_local, state.local_T_body))
    assert np.all(np.linalg.eigvalsh(state.covariance) > 0.0)
    assert share_on_walls(state.scan_points_m, grid) > 0.8
    assert state.counts["scans"] == SCANS and state.counts["scans_dropped"] == 0
    assert (grid.occupancy > 50).sum() > 200
    assert len(keyframes) == len(state.keyframes) == 1 + max(edge.j for edge in edges)
    assert state.latency_ms["median"] <= state.latency_ms["p99"] <= state.latency_ms["worst"]


def test_a_killed_back_end_is_replaced_and_nothing_is_lost(log, offline, tmp_path):
    messages = log[0]
    half = len(messages) // 2
    with LiveSlam(Config(), tmp_path) as slam:
        fed(slam, messages, half)
        before = slam.world_T_body
        os.kill(slam.back_end_pid, signal.SIGKILL)
        fed(slam, messages[half:])
        notes = slam.notes()
        finished = slam.finish(None, tmp_path / "drive", "simulated")
    assert np.array_equal(finished.world_T_body, offline.world_T_body)
    assert np.isfinite(before).all()
    assert any("SIGKILL" in note and "a new one reads everything again" in note for note in notes)


def test_a_back_end_that_dies_again_and_again_ends_the_run_in_one_line(log, tmp_path, monkeypatch):
    monkeypatch.setattr("mfslam.live.link.MOST_RESTARTS", 0)
    with LiveSlam(Config(), tmp_path) as slam:
        fed(slam, log[0], 300)
        os.kill(slam.back_end_pid, signal.SIGKILL)
        with pytest.raises(MfslamError, match="not started again"):
            slam.finish(None, tmp_path / "drive")


def test_keyframes_thin_out_while_the_back_end_is_held_up_and_it_is_told(log, tmp_path, monkeypatch):
    monkeypatch.setattr(pressure, "THIN_AT_S", 0.3)
    monkeypatch.setattr(pressure, "STEP_EVERY_S", 0.05)
    monkeypatch.setattr(pressure, "SPARSE_AT_S", 1e9)
    messages = log[0]
    with LiveSlam(Config(), tmp_path) as slam:
        fed(slam, messages, 200)
        slam.may_thin = True
        slam.feed(messages[200])
        os.kill(slam.back_end_pid, signal.SIGSTOP)
        for message in messages[201:700]:
            slam.feed(message)
            time.sleep(0.003)
        os.kill(slam.back_end_pid, signal.SIGCONT)
        assert slam.pressure.spacing > 1.0
        for message in messages[700:]:
            slam.feed(message)
        slam.wait(1)
        notes, counts = slam.notes(), slam.state().counts
    assert any("too slow for every keyframe" in note for note in notes)
    assert counts["scans_dropped"] == 0


def test_spacing_grows_step_by_step_to_its_limit_and_comes_back():
    findings = Findings()
    relief = Pressure(findings)
    times = np.arange(0.0, 100.0, 1.0)
    grown = [relief.spacing for t in times if relief.watch(10.0, t) or True]
    assert max(grown) == MOST and grown == sorted(grown)
    back = [relief.spacing for t in times + 100.0 if relief.watch(0.0, t) or True]
    assert back[-1] == 1.0
    assert findings.count("keyframes-thinned") >= 3


def test_scans_are_left_out_only_when_the_map_is_far_behind():
    relief = Pressure(Findings())
    assert all(relief.goes_to_map(n, 10.0) for n in range(10))
    kept = [relief.goes_to_map(n, 60.0) for n in range(10)]
    assert sum(kept) == 5 and relief.not_mapped == 5
    assert relief.findings.count("scans-not-mapped") == 5


def test_a_journal_gives_back_what_was_put_in_and_leaves_no_file(tmp_path):
    import pickle

    journal = Journal(tmp_path)
    items = [(n, np.arange(n)) for n in range(50)]
    for item in items:
        journal.append(item)
    offset, out = 0, []
    while journal.wait_beyond(offset, 0.0):
        data, offset = journal.read(offset)
        out.append(pickle.loads(data))
    assert [n for n, _ in out] == [n for n, _ in items]
    assert all(np.array_equal(a[1], b[1]) for a, b in zip(out, items, strict=True))
    assert not list(tmp_path.iterdir())
    journal.close()


def test_a_full_disk_is_told_in_one_line(tmp_path, monkeypatch):
    journal = Journal(tmp_path)

    class Full:
        def write(self, data):
            raise OSError(28, "No space left on device")

    monkeypatch.setattr(journal, "_file", Full())
    with pytest.raises(MfslamError, match=r"journal .*no space left.*free some disk"):
        journal.append(1)


def test_a_finish_without_scans_says_so(tmp_path):
    with LiveSlam(Config(), tmp_path) as slam, pytest.raises(MfslamError, match="no scan"):
        slam.finish(None, tmp_path / "nothing")


def test_standing_still_costs_no_memory_of_ranges(log):
    from mfslam.live.mapper import ENOUGH_SCANS, Mapper

    mapper = Mapper(Config(), None)
    scan = next(m for m in log[0] if isinstance(m, Scan))
    for n in range(60):
        again = Scan(scan.stamp_ns + n * 100_000_000, scan.ranges_m.copy(), scan.laser)
        mapper.feed(n, again)
    kept = [s for s in mapper.slam.scans if np.isfinite(s.ranges_m).any()]
    assert ENOUGH_SCANS <= len(kept) <= ENOUGH_SCANS + 2
    assert len(mapper.slam.scans) == 59  # every one of them has a pose
    blanks = {id(s.ranges_m) for s in mapper.slam.scans if not np.isfinite(s.ranges_m).any()}
    assert len(blanks) == 1


def test_errors_of_ranges_are_taken_off_before_a_scan_is_placed():
    told = next(message for message in drive().messages if isinstance(message, Scan))
    wrong = replace(told, ranges_m=told.ranges_m + np.float32(0.05))
    config = Config()
    sensor = config.sensor.model_copy(update={"range_error_m": (0.05,)})
    knowing = Tracker(config.model_copy(update={"sensor": sensor}))
    right = Tracker(config).place(0, told), knowing.place(0, wrong)
    np.testing.assert_allclose(right[0].scan.ranges_m, right[1].scan.ranges_m, atol=1e-6)
