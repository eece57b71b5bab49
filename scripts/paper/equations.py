"""The paper's equations under their numbers: as printed beside the exact ones, and how far they are apart.

A ``printed_*`` function is what the paper prints, and lives only here. The exact one is the engine's.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import numpy as np

from mfslam import se2
from mfslam.config import DeskewConfig
from mfslam.deskew import deskew
from mfslam.kernels import align
from mfslam.kinematics import body_twist, move
from mfslam.types import FloatArray, Scan
from paper.rig import MOUNT, RANGE_MAX_M, WHEELS, paper_laser
from paper.section import Effort, Section

V_M_S, W_RAD_S = 3.0, 2.0  # the case that slips are measured at
CYCLE_S = 0.1  # c_T: one control cycle, here as long as one turn of the laser
TURN_S = 0.1  # T_s
WALLS = 1000  # bare walls that eq. 36 is tried on


def wheel_rates(speed_m_s: float, yaw_rate_rad_s: float) -> tuple[float, float]:
    """Rates of the left and the right wheel, rad/s, at a true motion (eqs. 8-10 backwards)."""
    half = 0.5 * WHEELS.track_m * yaw_rate_rad_s
    return (speed_m_s - half) / WHEELS.radius_left_m, (speed_m_s + half) / WHEELS.radius_right_m


def printed_translation(m: FloatArray, q: FloatArray, rotation: FloatArray) -> FloatArray:
    """Eq. 4: t (2,) that minimises sum |m - R q + t|^2 over points (N, 2)."""
    return np.asarray(np.mean(q @ rotation.T - m, axis=0))


def printed_yaw_rate(left_m_s: float, right_m_s: float, track_m: float) -> float:
    """Eq. 11."""
    return math.atan((right_m_s - left_m_s) / track_m)


def printed_step(pose: FloatArray, speed_m_s: float, yaw_rate_rad_s: float, cycle_s: float) -> FloatArray:
    """Eqs. 12 and 40: pose (3,) a cycle later."""
    heading = pose[2] + yaw_rate_rad_s * cycle_s
    moved = abs(speed_m_s) * np.array([math.cos(heading), math.sin(heading)])
    return np.array([pose[0] + moved[0], pose[1] + moved[1], heading])


def mended_step(pose: FloatArray, speed_m_s: float, yaw_rate_rad_s: float, cycle_s: float) -> FloatArray:
    """Eq. 12 with the factor c_T that it lacks, and still the heading of the end for all of the way."""
    return printed_step(pose, speed_m_s * cycle_s, yaw_rate_rad_s * cycle_s, 1.0)


def printed_heading_rate(yaw_rate_rad_s: float, cycle_s: float) -> float:
    """Third row of eq. 13."""
    return yaw_rate_rad_s * cycle_s


def printed_beam_times(angles_rad: FloatArray, turn_s: float) -> FloatArray:
    """Eq. 15 with t_s = t_ND = 0: instants (N,) of beams at bearings (N,)."""
    return np.asarray(angles_rad / (2.0 * math.pi) * turn_s)


def printed_interpolation(before: FloatArray, after: FloatArray, share: float) -> FloatArray:
    """Eq. 16: x, y and heading one by one."""
    between: FloatArray = before + share * (after - before)
    return between


def printed_hits(pose: FloatArray, ranges_m: FloatArray, angles_rad: FloatArray) -> FloatArray:
    """Eqs. 17, 18, 41, 42: end points (N, 2) in the world of beams sensed from the body's pose (3,)."""
    bearing = pose[2] + angles_rad
    return np.asarray(pose[:2] + ranges_m[:, None] * np.stack([np.cos(bearing), np.sin(bearing)], axis=-1))


def printed_distance_errors(speed_m_s: float, turn_s: float, beams: int) -> FloatArray:
    """Eq. 19: e_d (N,) of each beam, n(D_t) counting the beams up to it."""
    return np.asarray(speed_m_s * turn_s / beams * np.arange(beams))


def printed_compensation(
    range_max_m: float, errors_m: FloatArray, angles_rad: FloatArray, speed_m_s: float, turn_s: float
) -> FloatArray:
    """Eqs. 20-24: points (N, 2) on the laser, from the greatest range d_L and e_d (N,)."""
    faster = speed_m_s > range_max_m / turn_s  # eq. 20
    ranges = np.abs(range_max_m + errors_m if faster else range_max_m - errors_m)
    return np.asarray(ranges[:, None] * np.stack([np.cos(angles_rad), np.sin(angles_rad)], axis=-1))


def printed_rotation(d: FloatArray, m: FloatArray) -> FloatArray:
    """Eqs. 27-36: R (2, 2) = V U^T between partners (N, 2); may be a reflection."""
    h = (d - d.mean(axis=0)).T @ (m - m.mean(axis=0))
    u, _, vt = np.linalg.svd(h)
    return np.asarray(vt.T @ u.T)


# --- how far apart -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Slip:
    """One equation: what is printed, what holds, where that lives, and how far apart they are in a case."""

    number: str
    printed: str
    exact: str
    lives_in: str
    case: str
    size: float
    unit: str


def slips() -> list[Slip]:
    """All slips, measured."""
    return [*_registration_slips(), *_motion_slips(), *_beam_slips(), *_range_slips()]


def _registration_slips() -> list[Slip]:
    rng = np.random.default_rng(0)
    q = rng.uniform(-2.0, 2.0, (100, 2))
    m_T_q = np.array([0.2, 0.0, 0.0])
    m = se2.transform(m_T_q, q)
    wrong = np.hypot(*(printed_translation(m, q, np.eye(2)) - align.rigid_fit(q, m)[:2]))
    reflected = 0
    for _ in range(WALLS):  # one bare wall, seen twice with 2 cm of noise
        along = rng.uniform(-2.0, 2.0, 100)
        d, partners = (np.stack([along, rng.normal(0.0, 0.02, 100)], axis=-1) for _ in range(2))
        reflected += int(np.linalg.det(printed_rotation(d, partners)) < 0.0)
    here = "`kernels.align.rigid_fit`"
    return [
        Slip("4", "`m - R q + t`", "`m - (R q + t)`: else t of (6) points backwards", here, "scans 0.2 m apart", float(wrong), "m"),
        Slip("36", "`R = V U^T`", "`V diag(1, det(V U^T)) U^T`: else R may be a reflection", here, "a bare wall seen twice: share reflected", 100.0 * reflected / WALLS, "%"),
    ]  # fmt: skip


def _motion_slips() -> list[Slip]:
    twist = body_twist(*wheel_rates(V_M_S, W_RAD_S), WHEELS)
    exact = move(np.zeros(3), twist, CYCLE_S)
    printed = printed_step(np.zeros(3), V_M_S, W_RAD_S, CYCLE_S)
    mended = mended_step(np.zeros(3), V_M_S, W_RAD_S, CYCLE_S)
    back = move(np.zeros(3), body_twist(*wheel_rates(-V_M_S, 0.0), WHEELS), CYCLE_S)
    half = 0.5 * WHEELS.track_m * W_RAD_S
    yaw = printed_yaw_rate(V_M_S - half, V_M_S + half, WHEELS.track_m)
    fast = f"{V_M_S:g} m/s, {W_RAD_S:g} rad/s, one cycle of {CYCLE_S:g} s"
    here = "`kinematics.move`"
    return [
        Slip("11", "`Omega = atan((v_R - v_L) / L)`", "without the arctangent", "`kinematics.body_twist`", fast, math.degrees((twist[2] - yaw) * CYCLE_S), "deg"),
        Slip("12, 40", "`x + \\|v\\| cos(phi + Omega c_T)`", "the factor c_T", here, fast, float(np.hypot(*(printed - exact)[:2])), "m"),
        Slip("12, 40", "heading of the end for all of the way", "the arc `T exp((v, 0, Omega) c_T)`", here, fast + ", with c_T put in", float(np.hypot(*(mended - exact)[:2])), "m"),
        Slip("12, 40", "`\\|v\\|`", "v with its sign", here, f"reverse at {V_M_S:g} m/s, one cycle, with c_T put in", float(np.hypot(*(mended_step(np.zeros(3), -V_M_S, 0.0, CYCLE_S) - back)[:2])), "m"),
        Slip("13", "`d phi / dt = Omega c_T`", "`Omega`", here, f"{W_RAD_S:g} rad/s", abs(printed_heading_rate(W_RAD_S, CYCLE_S) - float(twist[2])), "rad/s"),
    ]  # fmt: skip


def _beam_slips() -> list[Slip]:
    laser = paper_laser().laser
    late_s = float(np.max(np.abs(printed_beam_times(laser.angles_rad, TURN_S) - laser.offsets_s)))
    before, after = np.array([0.0, 0.0, math.radians(179.0)]), np.array([0.0, 0.0, math.radians(-179.0)])
    turned = se2.wrap(printed_interpolation(before, after, 0.5)[2] - se2.interpolate(before, after, 0.5)[2])
    arc = move(np.zeros(3), np.array([V_M_S, 0.0, W_RAD_S]), CYCLE_S)
    chord = printed_interpolation(np.zeros(3), arc, 0.5) - se2.interpolate(np.zeros(3), arc, 0.5)
    scan = Scan(0, np.full(len(laser.angles_rad), 1.2, dtype=np.float32), laser)
    hits = deskew(scan, np.zeros(3), DeskewConfig(mode="pose")).points_m
    unmounted = printed_hits(np.zeros(3), scan.ranges_m.astype(np.float64), laser.angles_rad)
    here = "`se2.interpolate`"
    return [
        Slip("15", "`t_s + theta_j / (2 pi) T_s`", "`theta_j - theta_S`: counted from the start of the scan", "`drivers.laser_models.beam_offsets`", f"240 deg in 66.6 ms, {V_M_S:g} m/s", late_s * V_M_S, "m"),
        Slip("16", "headings interpolated as numbers", "the short way round", here, "half way from 179 to -179 deg", abs(math.degrees(float(turned))), "deg"),
        Slip("16", "x and y on the chord", "on the arc, at constant twist", here, f"{V_M_S:g} m/s, {W_RAD_S:g} rad/s, readings {CYCLE_S:g} s apart, half way", float(np.hypot(*chord[:2])), "m"),
        Slip("17, 18, 41, 42", "beams start at the robot's origin", "at the laser's mount (x, y, yaw)", "`kernels.scans.project_beams`", f"laser {MOUNT[0]:g} m ahead", float(np.max(np.hypot(*(hits - unmounted).T))), "m"),
    ]  # fmt: skip


def _range_slips() -> list[Slip]:
    laser = paper_laser().laser
    angles, times = laser.angles_rad, laser.offsets_s
    errors = printed_distance_errors(V_M_S, TURN_S, len(angles))
    exact_errors = V_M_S * times
    # a wall 3 m ahead of a robot that drives straight on: the beam ahead, sensed in the middle of the scan
    ahead = int(np.argmin(np.abs(angles)))
    still_m = 3.0
    sensed_m = still_m - exact_errors[ahead]
    ahead_off = abs(sensed_m - exact_errors[ahead] - still_m)
    on_circle = printed_compensation(RANGE_MAX_M, np.zeros(len(angles)), angles, V_M_S, TURN_S)
    scan = Scan(0, np.full(len(angles), 1.2, dtype=np.float32), laser)
    twist = np.array([V_M_S, 0.0, 0.0])
    by_range, by_pose = (deskew(scan, twist, DeskewConfig(mode=mode)).points_m for mode in ("range", "pose"))
    aside = float(np.hypot(*(by_range[-1] - by_pose[-1])))
    here = "`deskew`, `deskew.mode: range`"
    return [
        Slip("19", "`v T_s / M` per beam, T_s a whole turn", "the time of 240 deg", here, f"last beam, {V_M_S:g} m/s", float(errors[-1] - exact_errors[-1]), "m"),
        Slip("21-24, 41", "the greatest range d_L", "the range d_j of the beam", here, "a wall 1.2 m away", float(np.min(np.hypot(*on_circle.T))) - 1.2, "m"),
        Slip("23, 24", "`d - e_d`", "`d + e_d`, points as of the first beam (e_d counts from there)", here, f"beam ahead, {V_M_S:g} m/s", float(ahead_off), "m"),
        Slip("19-24", "one number along the beam", "every beam from its own pose (14-18)", "`deskew`, `deskew.mode: pose`", f"last beam, {V_M_S:g} m/s", aside, "m"),
        Slip("20", "a branch at `V_R = d_L / T_s`", "never taken", "not needed", "URG-04LX: V_R", RANGE_MAX_M / TURN_S, "m/s"),
    ]  # fmt: skip


# --- the page ------------------------------------------------------------------------------------------

PLAIN = """Used as printed: (1-3) nearest partners, `kernels.align.point_to_point` with `icp.partners: nearest`; (5, 6) the update;
(7) dead reckoning, `kinematics.WheelIntegrator`; (8-10) wheels to speed, `kinematics.body_twist`; (14) bearings,
`drivers.laser_models.beam_angles`; (25) mutual partners, `icp.partners: mutual`; (26-35) and (37-39) the closed form,
`kernels.align.rigid_fit`. In (42) the third row adds 1 and 1; it is left out."""


def run(effort: Effort) -> Section:
    found = slips()
    lines = [
        "| eq. | the paper prints | exact | where | case | apart |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    lines += [
        f"| {s.number} | {s.printed} | {s.exact} | {s.lives_in} | {s.case} | {s.size:.3g} {s.unit} |"
        for s in found
    ]
    body = "\n\n".join(
        [
            "What slips in print, what is computed instead, and what each slip would cost.",
            "\n".join(lines),
            PLAIN,
        ]
    )
    return Section("The equations", body, [], {"slips": [asdict(s) for s in found]})
