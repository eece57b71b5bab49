"""Every setting, its unit, meaning and default, by stage. Files and ``--set`` (`mfslam.settings`) hold only what
differs."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from mfslam.types import FloatArray


class _Stage(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class SensorConfig(_Stage):
    """The laser: geometry and timing. Empty (null) values are taken from the log where it tells them."""

    name: str = Field("generic", description="Name of the sensor model; for reports only.")
    angle_min_deg: float | None = Field(
        None, description="Bearing of the first beam in the laser frame, deg. Null: from the log."
    )
    angle_step_deg: float | None = Field(
        None, description="Bearing from one beam to the next (eq. 14), deg. Null: from the log."
    )
    range_min_m: float | None = Field(
        None, ge=0, description="Shorter ranges are ignored, m. Null: from the log."
    )
    range_max_m: float | None = Field(
        None, gt=0, description="Ranges at or beyond this are no return, m. Null: from the log."
    )
    range_sigma_m: float = Field(0.02, gt=0, description="One-sigma noise of one range, m.")
    range_error_m: tuple[float, ...] = Field(
        (),
        description="By how much ranges are told too large, m, at range 0, range_error_step_m, twice that, ...; linear in "
        "between. Empty: they are right.",
    )
    range_error_step_m: float = Field(0.25, gt=0, description="Ranges of range_error_m are so far apart, m.")
    turn_period_s: float | None = Field(
        None,
        ge=0,
        description="Period of one mirror turn T_s (eq. 15), s. Null: from the log; 0: a snapshot.",
    )
    interlace: int = Field(
        1,
        ge=1,
        description="Mirror turns that make up one scan with interleaved beams (SICK LMS: 0.5 deg takes 2).",
    )
    reversed_beams: bool = Field(
        False, description="The laser turns against the order of its beams: the last beam is sensed first."
    )
    upside_down: bool = Field(False, description="The laser is mounted upside down: bearings change sign.")
    stamp_at: Literal["first", "middle", "last"] = Field(
        "first", description="Beam of the scan that the stamp belongs to."
    )
    transport_delay_s: float = Field(
        0.0,
        description="t_ND (eq. 15): added to every beam's instant, s. Negative: scans are older than their "
        "stamps say, measured on the wheels' clock.",
    )
    clock_drift: float = Field(
        0.0,
        gt=-0.1,
        lt=0.1,
        description="The laser's clock gains this against the wheels', s per s from the log's start: taken off.",
    )
    mount_x_m: float | None = Field(
        None, description="Laser ahead of the body's origin, m. Null: from the log, else 0."
    )
    mount_y_m: float | None = Field(
        None, description="Laser left of the body's origin, m. Null: from the log, else 0."
    )
    mount_yaw_deg: float | None = Field(
        None, description="Laser's heading on the body, deg. Null: from the log, else 0."
    )


class WheelsConfig(_Stage):
    """Differential drive (eqs. 7-13): needed only for logs of encoder ticks or wheel angles."""

    radius_left_m: float = Field(0.05, gt=0, description="Radius of the left wheel, m.")
    radius_right_m: float = Field(0.05, gt=0, description="Radius of the right wheel, m.")
    track_m: float = Field(
        0.3, gt=0, description="Distance between the wheels L (effective track for tracked robots), m."
    )
    ticks_per_turn: float = Field(1024.0, gt=0, description="Encoder ticks of one whole wheel turn.")
    swap_sides: bool = Field(False, description="The log's first wheel is the right one.")
    left_reversed: bool = Field(False, description="The left wheel counts backwards: its signs are turned.")
    right_reversed: bool = Field(False, description="The right wheel counts backwards: its signs are turned.")
    left_joint: str | None = Field(
        None, description="JointState name of the left wheel. Null: found by name."
    )
    right_joint: str | None = Field(
        None, description="JointState name of the right wheel. Null: found by name."
    )
    yaw_rate_rule: Literal["exact", "arctangent"] = Field(
        "exact", description="(v_R - v_L)/L, or eq. 11's arctangent of it as the paper prints it."
    )


class OdometryConfig(_Stage):
    """How far the wheels are believed: slip-aware noise of a wheel-odometry factor."""

    use: bool = Field(True, description="Use wheel odometry where the log has it.")
    sigma_translation_per_m: float = Field(0.05, gt=0, description="Sigma of the distance driven, m per m.")
    sigma_lateral_per_m: float = Field(0.03, gt=0, description="Sigma of sideways slip, m per m.")
    sigma_rotation_per_rad: float = Field(0.08, gt=0, description="Sigma of a turn, rad per rad turned.")
    sigma_rotation_per_m: float = Field(0.03, gt=0, description="Sigma of heading drift, rad per m driven.")
    sigma_floor_m: float = Field(0.005, gt=0, description="Floor of the translation sigma of any step, m.")
    sigma_floor_rad: float = Field(0.003, gt=0, description="Floor of the rotation sigma of any step, rad.")
    learn_errors: bool = Field(
        True,
        description="Learn the wheels' systematic errors (scale, drift, turn) from the scans on the way.",
    )
    white_share: float = Field(
        0.3,
        gt=0,
        le=1,
        description="Share of a step's information that goes into the graph: what is not learned of the wheels' "
        "errors adds up over about 1/share steps.",
    )
    max_speed_m_s: float = Field(10.0, gt=0, description="Faster wheel motion is a jump, not driving, m/s.")
    max_yaw_rate_rad_s: float = Field(10.0, gt=0, description="Faster wheel turning is a jump, rad/s.")

    @property
    def step_noise(self) -> FloatArray:
        """(3, 3) sigmas along, across and of the turn: of any step, per metre, per radian."""
        return np.array(
            [
                [self.sigma_floor_m, self.sigma_translation_per_m, 0.0],
                [self.sigma_floor_m, self.sigma_lateral_per_m, 0.0],
                [self.sigma_floor_rad, self.sigma_rotation_per_m, self.sigma_rotation_per_rad],
            ]
        )


class ImuConfig(_Stage):
    """Gyro and compass: heading only."""

    use_gyro: bool = Field(True, description="Use the gyro's yaw rate where the log has one.")
    use_compass: bool = Field(
        False, description="Use absolute headings (compass or fused). Off: steel indoors bends them."
    )
    gyro_scale: float = Field(
        1.0, gt=0, description="Yaw rate told per true one: readings are divided by it."
    )
    gyro_bias_rad_s: float = Field(0.0, description="Told at rest: taken off the readings, rad/s.")
    gyro_sigma_rad_per_sqrt_s: float = Field(
        0.005, gt=0, description="Noise of the integrated yaw, rad per root s."
    )
    bias_sigma_rad_s: float = Field(0.003, gt=0, description="What stays unknown of the gyro's bias, rad/s.")
    compass_sigma_deg: float = Field(10.0, gt=0, description="One-sigma error of an absolute heading, deg.")


class DeskewConfig(_Stage):
    """Where each beam is taken to have been sensed from."""

    mode: Literal["pose", "range", "none"] = Field(
        "pose",
        description="pose: every beam from its own pose (eqs. 14-18); range: the paper's scalar range "
        "correction (eqs. 19-24); none: the scan is a snapshot (conventional).",
    )


class IcpConfig(_Stage):
    """Registration of two deskewed scans."""

    method: Literal["point_to_line", "point_to_point"] = Field(
        "point_to_line",
        description="point_to_line: robust Gauss-Newton; point_to_point: the paper's closed form by SVD (eqs. 25-39).",
    )
    partners: Literal["mutual", "nearest"] = Field(
        "mutual",
        description="Partners of point_to_point. mutual: each the other's nearest (w_ij of eq. 25); nearest: the "
        "nearest, whoever else takes it (eq. 3).",
    )
    max_iterations: int = Field(
        15,
        ge=1,
        description="Iterations at most. Those of one match in fifty go on between two states as good as each other.",
    )
    search_radius_m: float = Field(0.5, gt=0, description="Partners are sought this far at the start, m.")
    final_radius_m: float = Field(0.15, gt=0, description="Partners are sought this far at the end, m.")
    kernel_sigmas: float = Field(3.0, gt=0, description="Scale of the Geman-McClure kernel, in range sigmas.")
    point_spacing_m: float = Field(0.05, ge=0, description="Points of a scan are thinned to this spacing, m.")
    independent_share: float = Field(
        0.15,
        gt=0,
        le=1,
        description="Share of the beams that count as independent in the information of a match: errors of "
        "neighbouring beams are correlated.",
    )
    open_share: float = Field(
        0.01,
        ge=0,
        lt=1,
        description="A direction with less than this share of the information across it is open, as along a "
        "bare corridor: noise feigns that much.",
    )
    sigma_floor_m: float = Field(0.004, ge=0, description="Systematic error of any match, m (one sigma).")
    sigma_floor_deg: float = Field(0.10, ge=0, description="Systematic error of any match, deg (one sigma).")

    @property
    def sigma_floor_rad(self) -> float:
        return math.radians(self.sigma_floor_deg)


class FrontendConfig(_Stage):
    """From scan to scan: prediction, matching against the recent past, choice of keyframes."""

    keyframe_distance_m: float = Field(0.3, gt=0, description="A keyframe at least every so far, m.")
    keyframe_angle_deg: float = Field(
        15.0, gt=0, description="A keyframe at least every so much turning, deg."
    )
    local_keyframes: int = Field(14, ge=1, description="Keyframes that make up the recent map.")
    min_inlier_ratio: float = Field(
        0.55,
        gt=0,
        lt=1,
        description="Below this share of partnered points a fit is poor and a search is made.",
    )
    joint_twist: bool = Field(
        True,
        description="Without wheels: estimate the twist through a scan together with its match; else take the mean "
        "motion since the scan before.",
    )
    search_window_m: float = Field(
        8.0,
        gt=0,
        description="Half window of the recovery search at most, m: it is as wide as inertia allows.",
    )
    search_angle_deg: float = Field(
        180.0, gt=0, description="Half window of the recovery search at most, deg."
    )


class LoopsConfig(_Stage):
    """Loop closure: where it is sought, and what is demanded of it before it is believed."""

    use: bool = Field(True, description="Close loops.")
    every_m: float = Field(1.0, gt=0, description="A search at least every so far driven, m.")
    min_travel_m: float = Field(
        8.0, gt=0, description="Places left less than this ago are no loop, m driven."
    )
    segment_m: float = Field(6.0, gt=0, description="Path whose scans are merged into one place, m.")
    reach_m: float = Field(8.0, gt=0, description="Two places may overlap when this near, m.")
    window_sigmas: float = Field(
        3.0, gt=0, description="Half window of the search, in sigmas of the prediction."
    )
    min_window_m: float = Field(0.5, gt=0, description="Half window at least, m.")
    max_places: int = Field(40, ge=1, description="Places tried in one search.")
    max_near_places: int = Field(
        3, ge=1, description="Places tried in one search while the position is sure."
    )
    gain_sigmas: float = Field(
        4.0,
        ge=0,
        description="A place is tried only where the graph is less sure of it than so many sigmas of a loop's "
        "systematic error, in position or heading.",
    )
    min_score: float = Field(
        0.35, gt=0, lt=1, description="Correlative score below which there is no candidate."
    )
    min_inlier_ratio: float = Field(
        0.4, gt=0, lt=1, description="Share of the commonly seen points that must fit closely."
    )
    min_agreement: float = Field(
        0.85,
        gt=0,
        lt=1,
        description="Share of commonly seen points that must not lie in the other's free space.",
    )
    max_sigma_m: float = Field(
        0.1, gt=0, description="A loop that leaves a direction open beyond this is no loop, m (one sigma)."
    )
    min_coverage: float = Field(
        0.4, gt=0, lt=1, description="Share of a place that the other must have seen."
    )
    ambiguous_score: float = Field(
        0.9,
        gt=0,
        le=1,
        description="A runner-up elsewhere with this share of the best score makes it ambiguous.",
    )
    wide_window_m: float = Field(1.5, gt=0, description="In wider windows several loops must agree, m.")
    wide_inlier_ratio: float = Field(0.5, gt=0, lt=1, description="min_inlier_ratio in wide windows.")
    wide_agreement: float = Field(0.9, gt=0, lt=1, description="min_agreement in wide windows.")
    torn_agreement: float = Field(
        0.98,
        gt=0,
        lt=1,
        description="wide_agreement over a tear of the path: the robot may as well be where it never was, in a place that "
        "looks alike.",
    )
    wide_every_m: float = Field(
        2.0, gt=0, description="A search in wide windows at most every so far driven, m."
    )
    sigma_floor_m: float = Field(
        0.02, ge=0, description="Systematic error of a loop, m: the places it joins are bent a little."
    )
    sigma_floor_deg: float = Field(0.3, ge=0, description="Systematic error of a loop, deg.")
    partners: int = Field(2, ge=0, description="Loops that must agree with a new one from a wide window.")


class GraphConfig(_Stage):
    """The pose graph and its solvers."""

    loop_kernel_sigmas: float = Field(
        3.0, gt=0, description="Scale of the Cauchy kernel on loops online, sigmas."
    )
    loop_inlier_probability: float = Field(
        0.999,
        gt=0,
        lt=1,
        description="Loops whose chi2 is above this quantile are outliers in the final solve.",
    )
    loop_satisfied_m: float = Field(
        0.2,
        gt=0,
        description="A loop in use is off by less than this in the final solve, m; else it is taken out.",
    )
    loop_satisfied_deg: float = Field(1.0, gt=0, description="The same of its rotation, deg.")
    gate_probability: float = Field(
        0.999, gt=0, lt=1, description="A loop must lie inside this quantile of the joint marginal."
    )


class RefineConfig(_Stage):
    """The second pass over the keyframes, from the optimised trajectory."""

    passes: int = Field(
        2,
        ge=0,
        description="Rounds of deskewing all keyframes and adjusting them with the walls that they saw.",
    )
    iterations: int = Field(
        4, ge=1, description="Iterations of the first round at most; later ones need half."
    )
    search_radius_m: float = Field(
        0.25,
        gt=0,
        description="How far a point may lie from its wall in the first round at most, m; later half of it.",
    )
    localise: bool = Field(
        True, description="Match the scans between keyframes once more with all keyframes around them."
    )
    other_passes: int = Field(
        5, ge=0, description="Surfaces of other passes by the same spot that they are matched with at most."
    )
    min_inlier_ratio: float = Field(
        0.4, gt=0, lt=1, description="Share of matched points that a scan between keyframes needs."
    )


class MapConfig(_Stage):
    """The occupancy grid made of every beam of every scan."""

    resolution_m: float = Field(0.05, gt=0, description="Cell size of map.pgm, m.")
    max_range_m: float = Field(30.0, gt=0, description="Beams are traced no farther than this, m.")
    no_return_free_m: float = Field(
        0.0, ge=0, description="Free space taken from beams without return, m along the beam. 0: none."
    )
    pose_sigma_m: float = Field(
        0.015,
        ge=0,
        description="What is left of the poses' errors, one sigma, m: with the range's noise it says how far a "
        "wall's hits are spread, and so what is brought to one cell.",
    )
    max_points: int = Field(
        20_000_000,
        ge=1,
        description="Points of points.ply at most: of more, only every second, third, ... is kept.",
    )
    min_hits: int = Field(2, ge=1, description="Fewer hits than this never make a cell occupied.")
    occupied_share: float = Field(
        0.15,
        gt=0,
        lt=1,
        description="A cell is occupied when hits / (hits + passes) is at least this: a thin leg of a chair may "
        "come to no more than 0.2, people who walk by come to less.",
    )


class ScipConfig(_Stage):
    """A live Hokuyo laser (SCIP 2.0): what is asked of it, and what its timestamps mark."""

    baud: int | None = Field(
        None,
        gt=0,
        description="Bit rate of a real serial line: the sensor is taken to it (every scan of a URG-04LX needs 250000). "
        "Null: as it is found; nothing over USB and TCP.",
    )
    mode: Literal["stream", "ask"] = Field(
        "stream", description="stream: the sensor sends scans (MD, MS); ask: each is asked for (GD, GS)."
    )
    angle_min_deg: float | None = Field(
        None, description="First bearing to measure, deg, ahead is 0. Null: all that the sensor sees."
    )
    angle_max_deg: float | None = Field(None, description="Last bearing to measure, deg. Null: all.")
    cluster: int = Field(
        1, ge=1, le=99, description="So many neighbouring steps are merged into their nearest."
    )
    skip_scans: int = Field(0, ge=0, le=9, description="Scans that the sensor leaves out between two.")
    short_ranges: bool = Field(
        False, description="Two characters a range instead of three: less to send, 4.095 m at most."
    )
    timestamp_at: Literal["step-0", "rear"] = Field(
        "step-0",
        description="What a timestamp marks: the sensor's step 0, as its specification says, or the direction "
        "straight back, as some drivers take it. For a URG-04LX 12.5 ms apart.",
    )


class BoardConfig(_Stage):
    """A live encoder board. Ticks and sides are those of ``wheels``."""

    baud: int | None = Field(
        None,
        gt=0,
        description="Bit rate. Null: 115200 (board), 57600 (arduino: the firmware of ros_arduino_bridge).",
    )
    rate_hz: float = Field(50.0, gt=0, le=500, description="Readings asked of an arduino, Hz.")


class LdsConfig(_Stage):
    """A live laser that turns all the way round (rplidar:, lds:)."""

    clockwise: bool = Field(True, description="It turns clockwise as seen from above, as most of them do.")


class Config(_Stage):
    """All stages."""

    sensor: SensorConfig = SensorConfig()
    wheels: WheelsConfig = WheelsConfig()
    odometry: OdometryConfig = OdometryConfig()
    imu: ImuConfig = ImuConfig()
    deskew: DeskewConfig = DeskewConfig()
    icp: IcpConfig = IcpConfig()
    frontend: FrontendConfig = FrontendConfig()
    loops: LoopsConfig = LoopsConfig()
    graph: GraphConfig = GraphConfig()
    refine: RefineConfig = RefineConfig()
    map: MapConfig = MapConfig()
    scip: ScipConfig = ScipConfig()
    board: BoardConfig = BoardConfig()
    lds: LdsConfig = LdsConfig()
