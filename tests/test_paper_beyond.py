"""Beyond the paper: its drives, its measures in closed form, and the short version of the section."""

from __future__ import annotations

import json
import math
import sys
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

SCRIPTS = Path(__file__).resolve().parents[1] / "scripts"
if str(SCRIPTS) not in sys.path:
    sys.path.insert(0, str(SCRIPTS))

from paper import beyond, beyond_claims, beyond_logs, beyond_pages, beyond_ramps  # noqa: E402
from paper.beyond_conditions import Condition, hall, laser, motion, ramps  # noqa: E402
from paper.beyond_logs import LogOutcome  # noqa: E402
from paper.beyond_plan import QUICK  # noqa: E402
from paper.beyond_runs import CONSTANT, ENGINE, JOINT, WITHOUT_WHEELS, Method, Outcome, Truth, drive_for, run  # noqa: E402
from paper.section import Effort  # noqa: E402

from drivers.simulator import Motion  # noqa: E402
from mfslam.deskew import beam_times_s  # noqa: E402
from mfslam.slam import Slam  # noqa: E402

STRAIGHT = Condition(drive="surge", speed_m_s=2.0, share=0.25)


def truth_of(monkeypatch: pytest.MonkeyPatch, true_motion: Motion, condition: Condition) -> Truth:
    monkeypatch.setattr("paper.beyond_runs.motion", lambda _: true_motion)
    return Truth(condition)


@pytest.mark.parametrize("speed_m_s", [1.0, 6.0])
def test_laps_keep_to_their_speed_and_close(speed_m_s: float) -> None:
    lap = motion(Condition(speed_m_s=speed_m_s))
    fastest = np.abs(lap.twists).max(axis=0)
    assert fastest[0] == pytest.approx(speed_m_s, rel=1e-6)
    assert fastest[2] < 1.5 * speed_m_s / 6.0
    start, end = lap.world_T_body[0], lap.world_T_body[-1]
    assert end[1] == pytest.approx(start[1], abs=0.3)
    assert 8.0 < end[0] - start[0] < 13.0  # once round, and its beginning once more


@pytest.mark.parametrize("rate", [1.0, 4.0])
def test_spins_turn_once_round_and_stay_on_their_line(rate: float) -> None:
    spun = motion(Condition(drive="spins", yaw_rate_rad_s=rate))
    assert np.abs(spun.twists[:, 2]).max() == pytest.approx(rate)
    turned = np.sum(np.abs(spun.twists[:, 2]) * np.diff(spun.times_s))
    assert turned == pytest.approx(4 * 2.0 * math.pi, rel=1e-6)
    assert np.ptp(spun.world_T_body[:, 1]) < 1e-3


def test_surges_speed_up_and_brake_as_told() -> None:
    surge = motion(Condition(drive="surge", speed_m_s=3.0, surge_m_s2=8.0))
    speeds = np.abs(surge.twists[:, 0])
    assert speeds.max() == pytest.approx(4.5, abs=0.05)
    steps = np.abs(np.diff(surge.twists[:, 0])) / np.diff(surge.times_s)[1:]
    assert np.percentile(steps, 50) == pytest.approx(8.0, rel=0.02)
    assert np.hypot(*(surge.world_T_body[-1] - surge.world_T_body[0])[:2]) < 1e-6


def test_late_laser_tells_its_delay_only_when_known() -> None:
    unknown, known = (laser(Condition(rate_hz=5.0, delay_s=0.1, delay_known=k)) for k in (False, True))
    assert unknown.period_s == known.period_s == 0.2
    assert unknown.reported is not None and known.reported is not None
    assert np.ptp(known.laser.offsets_s) == pytest.approx(0.2 * 359 / 360)
    np.testing.assert_allclose(unknown.reported.offsets_s, unknown.laser.offsets_s)
    np.testing.assert_allclose(known.reported.offsets_s, known.laser.offsets_s - 0.1)


def test_hall_leaves_the_lane_free() -> None:
    world = hall()
    path = motion(Condition()).world_T_body[::20, :2]
    a, b = world.segments[:, None, :2], world.segments[:, None, 2:]
    along = np.clip(np.sum((path - a) * (b - a), axis=-1) / np.sum((b - a) ** 2, axis=-1), 0.0, 1.0)
    clearance = np.linalg.norm(a + along[..., None] * (b - a) - path, axis=-1)
    assert clearance.min() > 0.5


def test_snapshot_error_of_a_straight_drive_is_speed_times_the_beams_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    steady = Motion.from_twists([3.0], [[2.0, 0.0, 0.0]], (14.0, 6.0, 0.0))
    truth = truth_of(monkeypatch, steady, STRAIGHT)
    still = np.zeros((len(truth.scans), 3))
    seen = np.isfinite(truth.exact_ranges_m)
    offsets = np.broadcast_to(beam_times_s(truth.sensor.laser), seen.shape)[seen]
    expected = 2.0 * math.sqrt(np.mean(offsets**2))
    assert truth.scan_error_m(still, "none") == pytest.approx(expected, rel=1e-4)


def test_true_twist_leaves_no_error_in_a_scan(monkeypatch: pytest.MonkeyPatch) -> None:
    twist = np.array([1.5, 0.0, 2.0])
    truth = truth_of(monkeypatch, Motion.from_twists([3.0], [twist], (20.0, 6.0, 0.0)), STRAIGHT)
    assert truth.scan_error_m(np.tile(twist, (len(truth.scans), 1)), "pose") < 1e-5


def test_wheels_tell_the_motion_at_the_wrong_time_when_the_delay_is_unknown(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    accelerating = ramps([(4.0, 0.0, 4.0, 0.0, 0.0)], (14.0, 6.0, 0.0))
    perfect = replace(
        STRAIGHT,
        delay_s=0.1,
        radius_error=0.0,
        track_error=0.0,
        slip_m_per_sqrt_m=0.0,
        ticks_per_turn=1 << 20,
    )
    for known, late_s in ((False, 0.1), (True, 0.0)):
        truth = truth_of(monkeypatch, accelerating, replace(perfect, delay_known=known))
        inner = slice(5, -5)
        middle_s = truth.simulation.instants_s + 0.5 * float(np.ptp(truth.sensor.laser.offsets_s))
        np.testing.assert_allclose(truth.wheel_twists()[inner, 0], middle_s[inner] + late_s, atol=5e-3)


def test_blur_of_the_truth_is_one(monkeypatch: pytest.MonkeyPatch) -> None:
    twist = np.array([2.0, 0.0, 0.5])
    truth = truth_of(monkeypatch, Motion.from_twists([3.0], [twist], (20.0, 6.0, 0.0)), STRAIGHT)
    outcome = run(truth, ENGINE)
    assert outcome.ate_m < 0.02
    assert outcome.lost_share == 0.0
    assert outcome.blur == pytest.approx(1.0, abs=0.05)


def outcome(ate_m: float, ate_deg: float = 0.0) -> Outcome:
    return Outcome("some way", 0.0, 0.0, 0.0, 0.0, ate_m, ate_deg, 1.0, 0.0, 0.0, 0)


def test_of_use_needs_both_position_and_heading() -> None:
    assert beyond_pages.is_usable(outcome(0.1, 2.0))
    assert not beyond_pages.is_usable(outcome(0.101))
    assert not beyond_pages.is_usable(outcome(0.01, 2.1))


@pytest.mark.parametrize(
    ("usable", "expected"),
    [([True, True, True], "3 (all)"), ([True, False, True], "1"), ([False, True, True], "none")],
)
def test_reach_ends_at_the_first_drive_of_no_use(usable: list[bool], expected: str) -> None:
    assert beyond_pages.reach(np.array([usable]), ("1", "2", "3"), 0) == expected


def test_lost_drives_are_named_by_rate() -> None:
    spins = [Condition(drive="spins", yaw_rate_rad_s=w, rate_hz=5.0) for w in (3.0, 4.0)]
    assert beyond_pages.named([Condition(speed_m_s=6.0), *spins]) == "6 m/s at 10 Hz; 3, 4 rad/s at 5 Hz"
    assert beyond_pages.named([]) == "none"


@pytest.mark.parametrize("method", WITHOUT_WHEELS)
def test_without_wheels_only_a_known_delay_makes_another_drive(method: Method) -> None:
    spoilt = Condition(delay_s=0.1, slip_m_per_sqrt_m=0.05, radius_error=0.1, ticks_per_turn=32)
    assert drive_for(spoilt, method) == Condition()
    assert drive_for(spoilt, ENGINE) == spoilt
    assert drive_for(replace(spoilt, delay_known=True), method) == Condition(delay_s=0.1, delay_known=True)


def test_without_wheels_their_faults_change_nothing() -> None:
    short = Condition(speed_m_s=4.0, share=0.1)
    spoilt = replace(short, delay_s=0.1, slip_m_per_sqrt_m=0.05, radius_error=0.1, ticks_per_turn=32)
    outcomes = [asdict(run(Truth(condition), JOINT)) for condition in (spoilt, short)]
    names = [outcome.pop("method") for outcome in outcomes]
    assert names[0] == names[1]
    assert outcomes[0] == pytest.approx(outcomes[1], rel=1e-6)


RAMP = Condition(drive="ramps", yaw_rate_rad_s=2.0, rate_hz=5.0, share=0.5)


def test_ramps_reach_their_rate_in_half_a_second_both_ways() -> None:
    ramp = motion(RAMP)
    rates = ramp.twist_at(np.array([0.5, 1.25, 2.0, 3.25, 3.75, 4.25, 5.0, 7.0]))[:, 2]
    np.testing.assert_allclose(rates, [0.0, 1.0, 2.0, 1.0, 0.0, -1.0, -2.0, 0.0], atol=0.02)
    assert np.ptp(ramp.world_T_body[:, :2], axis=0).max() < 1e-9


def test_joint_twist_follows_a_ramp_that_a_constant_twist_lags_behind() -> None:
    watched = beyond_ramps.trace(RAMP)
    assert watched.rms_rad_s(JOINT) < 0.1 < 0.15 < watched.rms_rad_s(CONSTANT)
    assert (
        watched.scan_error_m[JOINT.name] < 0.65 * watched.scan_error_m[CONSTANT.name]
    )  # which inertia helps
    first = np.flatnonzero(np.abs(watched.mean_rad_s) > 0.1)[0]  # the step before told of a robot at rest
    assert watched.found_rad_s[CONSTANT.name][first] < watched.mean_rad_s[first]


def test_true_mean_of_a_scan_is_that_of_the_moments_in_it() -> None:
    watched = beyond_ramps.trace(RAMP)
    for start_s, mean in zip(watched.starts_s, watched.mean_rad_s, strict=True):
        inside = np.abs(watched.moments_s - start_s - 0.5 * watched.scan_s) <= 0.5 * watched.scan_s
        assert mean == pytest.approx(watched.true_rad_s[inside].mean(), abs=0.05)


@pytest.mark.parametrize("method", WITHOUT_WHEELS)
def test_watched_front_end_goes_where_the_engine_s_goes(method: Method) -> None:
    """The twists drawn are those that the engine maps with: its steps follow from the same front end."""
    truth = Truth(replace(RAMP, share=0.25))
    slam = Slam(method.config)
    for message in truth.messages:
        slam.feed(message)
    slam.finish()
    watched = beyond_ramps.watched_frontend(truth.scans, method)
    np.testing.assert_allclose(watched.local_T_body, slam.steps[-1].local_T_body, atol=1e-6)


def test_crisper_map_must_be_so_on_every_log() -> None:
    def outcomes(log: str, joint: int, constant: int) -> list[LogOutcome]:
        by_variant = {beyond_logs.JOINT_TWIST: joint, beyond_logs.CONSTANT_TWIST: constant}
        return [LogOutcome(log, variant, 9, cells, 1.0) for variant, cells in by_variant.items()]

    crisper, blurred = outcomes("a", 90, 100), outcomes("b", 120, 100)
    assert beyond_claims.logs_claim(crisper).holds
    claim = beyond_claims.logs_claim([*crisper, *blurred])
    assert not claim.holds
    assert claim.ours == "on 1 of 2 logs"
    assert claim.why == "2 cm cells: a -10.0 %; b +20.0 %"


def test_logs_that_are_absent_are_left_out(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("MFSLAM_DATA", str(tmp_path))
    assert beyond_logs.logs_at_hand() == []
    (tmp_path / "urg04lx").mkdir()
    (tmp_path / beyond_logs.LOGS[0]).touch()
    assert beyond_logs.logs_at_hand() == [tmp_path / beyond_logs.LOGS[0]]
    assert "left out" in beyond.logs_body([])


def test_short_version_measures_draws_and_says_what_it_found(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("MFSLAM_DATA", str(tmp_path))
    section = beyond.run(Effort(quick=True, jobs=2, figures=tmp_path))
    pictures = [
        *(beyond.FRONTIER_PNG, beyond.FAULT_FRONTIER_PNG, beyond.SCANS_PNG),
        *(beyond.FAULTS_PNG, beyond.RAMPS_PNG),
    ]
    for picture in pictures:
        assert (tmp_path / picture).read_bytes().startswith(b"\x89PNG")
        assert f"]({picture})" in section.body
    assert sum((tmp_path / picture).stat().st_size for picture in pictures) < 500_000
    assert str(tmp_path) not in section.body
    assert len(section.measured["drives"]) == len(QUICK.drives())
    base = next(d for d in section.measured["drives"] if d["condition"] == asdict(QUICK.base))
    by_name = {o["method"]: o for o in base["outcomes"]}
    assert by_name["conventional ICP"]["scan_error_m"] > 10.0 * by_name["motion-free ICP"]["scan_error_m"]
    assert by_name["whole engine"]["ate_m"] < 0.02 < by_name["conventional ICP"]["ate_m"]
    assert len(section.measured["ramps"]) == len(QUICK.ramps())
    json.dumps(section.measured)
    assert all(claim.ours and claim.why for claim in section.claims)
