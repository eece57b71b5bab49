"""Metrics in closed form, against evo, and on the logs' own relations."""

from __future__ import annotations

import gzip
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mfslam import se2
from mfslam.metrics import (
    Relations,
    align,
    associate,
    ate,
    crispness,
    read_relations,
    relations_error,
    rpe,
)
from mfslam.types import FloatArray, MfslamError

NS = 1_000_000_000
motions = st.tuples(st.floats(-50, 50), st.floats(-50, 50), st.floats(-3.1, 3.1)).map(np.array)


def trajectory(count: int = 200, seed: int = 3) -> FloatArray:
    rng = np.random.default_rng(seed)
    steps = rng.normal([0.3, 0.0, 0.05], [0.1, 0.01, 0.1], size=(count, 3))
    poses = np.zeros((count, 3))
    for n in range(1, count):
        poses[n] = se2.compose(poses[n - 1], steps[n])
    return poses


def noisy(poses: FloatArray, seed: int = 4) -> FloatArray:
    rng = np.random.default_rng(seed)
    return se2.compose(poses, rng.normal(0.0, [0.05, 0.05, 0.02], size=poses.shape))


# --- relations ---------------------------------------------------------------------------------------


def test_a_true_trajectory_has_no_error_whatever_its_frame_and_order() -> None:
    poses, stamps = trajectory(), np.arange(200, dtype=np.int64) * NS
    stamps[[20, 21]] = stamps[[21, 20]]  # the log's order is not the clock's
    relations = Relations(stamps[:-7], stamps[7:], se2.between(poses[:-7], poses[7:]))
    moved = se2.compose(np.array([30.0, -4.0, 2.0]), poses)
    error = relations_error(stamps, moved, relations)
    assert error.matched == 193
    assert error.translation_m.max < 1e-12
    assert error.rotation_deg.max < 1e-10


def test_error_is_inverse_relation_times_estimate() -> None:
    stamps = np.array([0, NS], dtype=np.int64)
    estimate = np.array([[0.0, 0.0, 0.0], [1.3, 0.4, 0.2]])
    relations = Relations(stamps[:1], stamps[1:], np.array([[1.0, 0.0, 0.1]]))
    error = relations_error(stamps, estimate, relations)
    assert error.translation_m.mean == pytest.approx(0.5)
    assert error.translation_m.mean_squared == pytest.approx(0.25)
    assert error.rotation_deg.mean == pytest.approx(math.degrees(0.1))


def test_statistics_of_known_errors() -> None:
    stamps = np.arange(101, dtype=np.int64) * NS
    estimate = np.zeros((101, 3))
    estimate[1:, 0] = np.arange(100.0)
    relations = Relations(np.zeros(100, dtype=np.int64), stamps[1:], np.zeros((100, 3)))
    stats = relations_error(stamps, estimate, relations).translation_m
    assert (stats.mean, stats.median, stats.max) == (49.5, 49.5, 99.0)
    assert stats.std == pytest.approx(math.sqrt((100**2 - 1) / 12))
    assert stats.p99 == pytest.approx(98.01)
    assert stats.rmse == pytest.approx(math.sqrt(99 * 199 / 6))


def test_unmatched_relations_are_counted_and_nothing_matched_tells_both_ranges() -> None:
    stamps, poses = np.arange(10, dtype=np.int64) * NS, trajectory(10)
    late = np.array([5 * NS, 5 * NS + 20_000], dtype=np.int64)  # the second is 20 us off: another scan
    error = relations_error(stamps, poses, Relations(np.zeros(2, dtype=np.int64), late, np.zeros((2, 3))))
    assert (error.matched, error.unmatched) == (1, 1)
    with pytest.raises(
        MfslamError, match=r"relations run from 100\.0+ to 105\.0+ s, poses from 0\.0+ to 9\.0+ s"
    ):
        relations_error(stamps, poses, Relations(late[:1] + 95 * NS, late[:1] + 100 * NS, np.zeros((1, 3))))
    with pytest.raises(MfslamError, match="poses from nothing"):
        relations_error(stamps[:0], poses[:0], Relations(late, late, np.zeros((2, 3))))


@pytest.mark.parametrize(
    "line", ["1 2 3 4 5 6 7", "1 2 3 4 5 6 7 x", "1 2 nan 4 5 6 7 8", "1 inf 3 4 5 6 7 8"]
)
def test_bad_relations_name_the_line(tmp_path: Path, line: str) -> None:
    path = tmp_path / "r.relations"
    path.write_text(f"# t1 t2 x y z roll pitch yaw\n1 2 3 4 5 6 7 0.5\n{line}\n")
    with pytest.raises(MfslamError, match=r"r\.relations:3: expected"):
        read_relations(path)


@pytest.mark.parametrize(
    ("name", "total", "near_m", "far_m"),
    [("intel", 2984, 0.022, 18.1), ("fr079", 1685, 0.058, 15.6), ("mit-killian", 4677, 0.032, 243.0)],
)
def test_raw_odometry_of_real_logs(
    shared_data: Path, name: str, total: int, near_m: float, far_m: float
) -> None:
    """The known errors of the logs' own odometry, on pairs under 5 s and over 20 s apart."""
    stamps, poses = [], []
    with gzip.open(shared_data / "freiburg" / f"{name}.clf.gz", "rt") as file:
        for line in file:
            if line.startswith("FLASER"):
                fields = line.rsplit(maxsplit=6)[1:]
                stamps.append(round(float(fields[3]) * NS))
                poses.append([float(field) for field in fields[:3]])
    relations = read_relations(shared_data / "freiburg" / f"{name}.relations")
    assert len(relations.a_ns) == total
    apart_s = np.abs(relations.b_ns - relations.a_ns) / NS
    for pick, expected_m in ((apart_s < 5, near_m), (apart_s > 20, far_m)):
        some = Relations(relations.a_ns[pick], relations.b_ns[pick], relations.a_T_b[pick])
        error = relations_error(np.array(stamps, dtype=np.int64), np.array(poses), some)
        assert error.unmatched == 0
        assert error.translation_m.mean == pytest.approx(expected_m, rel=0.03)


# --- ATE and RPE -------------------------------------------------------------------------------------


@given(motions)
@settings(max_examples=30)
def test_alignment_recovers_any_motion(motion: FloatArray) -> None:
    truth = trajectory(50)
    moved = se2.compose(se2.inverse(motion), truth)
    found = align(truth, moved)
    assert np.abs(se2.between(motion, found)).max() < 1e-9
    assert ate(truth, moved).translation_m.max < 1e-9
    assert ate(truth, moved, "origin").rotation_deg.max < 1e-6
    assert rpe(truth, moved, 5).translation_m.max < 1e-9


def test_ate_without_alignment_sees_the_offset() -> None:
    truth = trajectory()
    moved = truth + np.array([3.0, 4.0, 0.0])
    assert ate(truth, moved, "none").translation_m.mean == pytest.approx(5.0)


def test_best_alignment_is_the_least_squares_one() -> None:
    truth, estimate = trajectory(), noisy(trajectory())
    best = ate(truth, estimate).translation_m.rmse
    fit = align(truth, estimate)
    for nudge in 1e-3 * np.vstack([np.eye(3), -np.eye(3)]):
        other = se2.transform(fit + nudge, estimate[:, :2])
        assert np.sqrt(np.mean(np.sum((other - truth[:, :2]) ** 2, axis=1))) > best


def test_agrees_with_evo() -> None:
    metrics = pytest.importorskip("evo.core.metrics")
    from evo.core.trajectory import PoseTrajectory3D

    def as_evo(poses: FloatArray) -> PoseTrajectory3D:
        half, zero = 0.5 * poses[:, 2], np.zeros(len(poses))
        xyz = np.column_stack([poses[:, :2], zero])
        return PoseTrajectory3D(
            xyz, np.column_stack([np.cos(half), zero, zero, np.sin(half)]), np.arange(len(poses))
        )

    truth = trajectory()
    estimate = se2.compose(np.array([5.0, -2.0, 0.7]), noisy(truth))
    for alignment in ("none", "origin", "best"):
        reference, ours = as_evo(truth), as_evo(estimate)
        if alignment == "origin":
            ours.align_origin(reference)
        elif alignment == "best":
            ours.align(reference, correct_scale=False)
        mine = ate(truth, estimate, alignment)  # type: ignore[arg-type]
        for relation, stats in (
            (metrics.PoseRelation.translation_part, mine.translation_m),
            (metrics.PoseRelation.rotation_angle_deg, mine.rotation_deg),
        ):
            ape = metrics.APE(relation)
            ape.process_data((reference, ours))
            theirs = ape.get_all_statistics()
            for key, value in (
                ("mean", stats.mean),
                ("rmse", stats.rmse),
                ("median", stats.median),
                ("max", stats.max),
            ):
                assert value == pytest.approx(theirs[key], abs=1e-9), (alignment, relation, key)
    step = rpe(truth, estimate, 10)
    evo_step = metrics.RPE(metrics.PoseRelation.translation_part, 10, metrics.Unit.frames, all_pairs=True)
    evo_step.process_data((as_evo(truth), as_evo(estimate)))
    assert step.translation_m.rmse == pytest.approx(evo_step.get_all_statistics()["rmse"], abs=1e-9)


def test_association_takes_the_nearest_in_time() -> None:
    a = np.array([0, 100, 200, 900], dtype=np.int64) * 1_000_000
    b = np.array([203, 98, 5, 500], dtype=np.int64) * 1_000_000  # in no order
    i, j = associate(a, b, 0.01)
    assert i.tolist() == [0, 1, 2]
    assert j.tolist() == [2, 1, 0]
    with pytest.raises(MfslamError, match="one trajectory runs from"):
        associate(a, b + 10 * NS)


# --- crispness ---------------------------------------------------------------------------------------


def test_entropy_of_evenly_hit_cells_is_the_log_of_their_number() -> None:
    centres = (np.stack(np.meshgrid(np.arange(8), np.arange(4)), axis=-1).reshape(-1, 2) - 3 + 0.5) * 0.02
    sharp = crispness(np.repeat(centres, 5, axis=0), 0.02)
    assert sharp.cells == 32
    assert sharp.entropy_nats == pytest.approx(math.log(32))
    assert sharp.entropy_bits == pytest.approx(5.0)


def test_a_blurred_wall_is_less_crisp() -> None:
    rng = np.random.default_rng(5)
    wall = np.column_stack([rng.uniform(0, 5, 4000), np.full(4000, 0.01)])
    blurred = wall + rng.normal(scale=0.02, size=wall.shape)
    assert crispness(blurred).cells > 2 * crispness(wall).cells
    assert crispness(blurred).entropy_nats > crispness(wall).entropy_nats
    assert crispness(wall[:0]).cells == 0
