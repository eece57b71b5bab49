"""From a finished run to its calibration, and from that to the settings of the next run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mfslam import se2
from mfslam.calibration.gyro import fit_gyro
from mfslam.calibration.laser_turn import find_turn
from mfslam.calibration.outcome import Calibration, Estimate, calibration_of, gyro_estimates, turn_estimates
from mfslam.calibration.problem import Problem
from mfslam.calibration.range_errors import find_range_errors, merged
from mfslam.calibration.record import Record, cut_windows
from mfslam.calibration.solve import Solved, solve
from mfslam.calibration.start import Start, find_start
from mfslam.calibration.told_poses import paired
from mfslam.calibration.wheel_track import DifferentialDrive, PoseOdometry, WheelLaw
from mfslam.slam import Slam, Solution
from mfslam.types import FloatArray

LEAST_WINDOWS = 50
LEAST_CORRELATION = 0.5  # of the laser's turns and the wheels': below, they do not speak of one robot
LYING_S = 0.02  # stamps that go back by more tell no delay
POOR_FIT = 0.4
LENGTHS = (0.5, 2.0)  # of windows, times as long as usual: how far they disagree is a part of sigma


def record_of(slam: Slam, solution: Solution) -> Record | None:
    """What the run knows of laser and wheels; None where no wheels turned."""
    motion = slam.motion
    if not motion.odometry.has_moved or len(solution.world_T_reference) < 2:
        return None
    laser = slam.scans[0].laser
    times = np.maximum.accumulate(np.array(motion.times_s)) + 1e-9 * np.arange(len(motion.times_s))
    sure = np.array(
        [s.blind_s == 0.0 and (s.match is None or s.match.inlier_ratio > POOR_FIT) for s in slam.steps]
    )
    knots, steps = np.array(motion.told_times_s), np.array(motion.told_steps).reshape(-1, 3)
    told = motion.told_with_scans
    if told and all(pose is not None for pose in told):  # the wheels' pose at each scan, whatever the stamps
        usable = np.ones(len(times), np.bool_)
        usable[motion.jumps] = False
        poses = paired(np.array(told), times, usable[1:])
        knots = times
        steps = np.vstack([np.full((1, 3), np.nan), se2.between(poses[:-1], poses[1:])])
        steps[~usable] = np.nan
    # as matched: a body that never slips sideways, as the smoothing likes it, has its laser where it was assumed
    matched = se2.compose(solution.world_T_reference, se2.exp(-solution.smoothed_by))
    world_T_laser = se2.compose(matched, laser.body_T_laser)
    return Record(
        times,
        world_T_laser,
        sure,
        laser,
        knots,
        steps,
        motion.odometry.backwards_s,
        motion.comes_with_scans,
        *motion.heading.turns(),
    )


def calibrate(slam: Slam, solution: Solution) -> Calibration | None:
    """The calibration by a finished run; None where there are no wheels, or too little motion to say anything."""
    record = record_of(slam, solution)
    if record is None:
        return None
    windows = cut_windows(record)
    if len(windows) < LEAST_WINDOWS:
        return None
    config = slam.config
    clock = record.stamps_back_s < LYING_S
    start = find_start(record, windows, config.wheels.track_m, clock)
    if abs(start.correlation) < LEAST_CORRELATION:
        return None
    law: WheelLaw = (
        DifferentialDrive(config.wheels.track_m, start.signs) if slam.motion.counts_wheels else PoseOdometry()
    )
    problem = Problem(record, law, clock, start.delay_s)
    if len(problem.windows) < LEAST_WINDOWS:
        return None
    values = problem.start.copy()
    if clock:
        values[-2] = start.delay_s
    if slam.motion.counts_wheels:
        values[2] = start.track_share
    solved = solve(problem, values)
    if record.with_scans:
        scatter = scatter_over_lengths(problem, start.delay_s, solved)
        # the recorder put poses and scans together, whatever their stamps: a delay can be told, but not taken off
        solved = replace(solved, covariance=solved.covariance + scatter).of(problem.geometry)
        clock = False
    found = calibration_of(solved, record, start, config)
    gyro = fit_gyro(record, float(solved.values[-2]) if clock else 0.0)
    turn = None if slam.motion.comes_with_scans else find_turn(slam, solution)
    found = found.extended(gyro_estimates(gyro, config)).extended(turn_estimates(turn, config))
    if slam.motion.comes_with_scans or any(e.name == "turn_period" for e in found.significant):
        return found  # scans that a wrong turn has bent would tell wrong ranges
    return replace(found, range_errors=find_range_errors(slam, solution))


def calibrate_ranges(slam: Slam, solution: Solution) -> Calibration | None:
    """What walls alone tell of a laser, where wheels tell nothing."""
    ranges = find_range_errors(slam, solution)
    if ranges is None:
        return None
    as_told = Start(0.0, np.eye(2), 1.0, 1.0)
    return Calibration([], np.zeros((0, 0)), as_told, slam.config, range_errors=ranges)


def scatter_over_lengths(problem: Problem, delay_s: float, solved: Solved) -> FloatArray:
    """(P, P) by how far what longer and shorter windows tell is off ``solved``: of poses that were read at instants of
    which nobody knows how near the scans' they are, all that the model misses depends on the length of the windows."""
    out = np.zeros_like(solved.covariance)
    for length in LENGTHS:
        other = Problem(problem.record, problem.law, problem.clock, delay_s, length)
        if len(other.windows) >= LEAST_WINDOWS:
            off = solve(other, solved.values).values - solved.values
            out += np.outer(off, off)
    return out


def together(calibrations: Sequence[Calibration]) -> Calibration:
    """Of several logs of one robot: each counts by its information. All must speak of the same parameters.

    What the clocks did is of each log alone: their drift is not written, and the delay is that in the middle of the logs.
    """
    of_all = [n for n, e in enumerate(calibrations[0].estimates) if e.name != "clock_drift"]
    first = replace(calibrations[0], estimates=[calibrations[0].estimates[n] for n in of_all], middle_s=0.0)
    information = np.zeros((len(of_all), len(of_all)))
    vector: FloatArray = np.zeros(len(of_all))
    for calibration in calibrations:
        own = np.linalg.inv(calibration.covariance[np.ix_(of_all, of_all)])
        information += own
        vector += own @ np.array([calibration.estimates[n].value for n in of_all])
    covariance: FloatArray = np.asarray(np.linalg.inv(information))
    values = covariance @ vector
    estimates: list[Estimate] = [
        replace(e, value=float(values[n]), sigma=float(np.sqrt(covariance[n, n])), pulled=0.0)
        for n, e in enumerate(first.estimates)
    ]
    ranges = merged([calibration.range_errors for calibration in calibrations])
    return replace(first, estimates=estimates, covariance=covariance, range_errors=ranges)
