"""How sections become the page, and what setups of the engine stand for."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np
import pytest
from paper.aisle_claims import convergence_claims, time_claim
from paper.cases import CONVENTIONAL, MOTION_FREE, Setup
from paper.convergence import GUESSES, METHODS, Convergence
from paper.graph_on_top import setup_of
from paper.page import page_text
from paper.rig import SQUARE, paper_laser, paper_robot, settings_of
from paper.section import Claim, Section

from mfslam.config import Config


def _data(section: Section) -> dict[str, object]:
    return {**asdict(section), "seconds": 30.0, "quick": False}


def test_page_tells_claims_that_hold_and_that_do_not() -> None:
    claims = [Claim("It is fast", "2 ms", True, "it is"), Claim("It is small", "9 GB", False, "it is not")]
    page = page_text({"one": _data(Section("One", "![a](a.png)", claims))}, "images/paper")
    assert "| It is fast | 2 ms | yes | it is |" in page
    assert "| It is small | 9 GB | **no** | it is not |" in page
    assert "![a](images/paper/a.png)" in page
    assert "0.5 minutes" in page
    assert "Short version" not in page


def _config(setup: Setup) -> Config:
    return settings_of(*setup.presets, settings=setup.settings)


def test_paper_system_is_icp_that_starts_from_the_wheels_and_nothing_more() -> None:
    for setup, mode, partners in ((CONVENTIONAL, "none", "nearest"), (MOTION_FREE, "pose", "mutual")):
        config = _config(setup)
        assert (config.deskew.mode, config.icp.partners) == (mode, partners)
        assert config.icp.method == "point_to_point"
        assert not config.loops.use
        assert config.refine.passes == 0
        assert config.odometry.sigma_floor_m >= 1.0  # holds nothing


def test_parts_of_the_graph_are_switched_one_by_one() -> None:
    alone, full = _config(setup_of(False, False, False)), _config(setup_of(True, True, True))
    assert not alone.loops.use
    assert alone.refine.passes == 0
    assert alone.odometry.white_share < 1e-9
    assert alone.odometry.use  # the wheels still predict and compensate
    assert full == settings_of()


def test_settings_are_those_of_the_paper() -> None:
    config, laser = settings_of(), paper_laser()
    assert config.wheels.ticks_per_turn == 256
    assert config.wheels.track_m == paper_robot().wheels.track_m
    assert len(laser.laser.angles_rad) == 682
    assert laser.laser.range_max_m == 4.0
    assert laser.laser.offsets_s[-1] == pytest.approx(0.0666, abs=2e-4)
    assert paper_robot(mirrored=True).radius_error_left == paper_robot().radius_error_right


def _curve(x_mm: tuple[float, float], y_mm: tuple[float, float]) -> Convergence:
    x, y = (1e-3 * np.linspace(*ends, 16) for ends in (x_mm, y_mm))
    return Convergence(x, y, y, 10)


@pytest.mark.parametrize(("x_mm", "holds"), [(20.0, True), (60.0, False)])
def test_claims_of_the_icp_follow_the_figures(x_mm: float, holds: bool) -> None:
    conventional, motion_free = (method.name for method in METHODS)
    curves = {(conventional, guess): _curve((100.0, 50.0), (40.0, 20.0)) for guess in GUESSES}
    curves |= {(motion_free, guess): _curve((90.0, x_mm), (30.0, 10.0)) for guess in GUESSES}
    ends = [claim for claim in convergence_claims(SQUARE, curves) if "ends at" in claim.paper]
    assert [claim.holds for claim in ends] == [holds, holds]
    assert f"X {x_mm:.1f} against 50.0 mm" in ends[0].ours
    times = {conventional: 2.0, motion_free: 3.0}
    assert not time_claim(SQUARE, times, curves).holds
    assert "ratio 1.50" in time_claim(SQUARE, times, curves).ours
