"""scripts/map_truth.py and the map itself: simulated worlds whose true surfaces are known."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

import numpy as np
import pytest

SCRIPTS = Path(__file__).resolve().parents[1] / "scripts"
if str(SCRIPTS) not in sys.path:
    sys.path.insert(0, str(SCRIPTS))

from map_truth import measure_map, picture, true_surfaces  # noqa: E402

from drivers.simulator.robot import RobotModel  # noqa: E402
from drivers.simulator.sensing import beam_truth  # noqa: E402
from drivers.simulator.sensors import laser_model, laser_preset  # noqa: E402
from drivers.simulator.simulate import simulate  # noqa: E402
from drivers.simulator.world import parse_world  # noqa: E402
from mfslam import se2  # noqa: E402
from mfslam.deskew import reference_offset_s  # noqa: E402
from mfslam.mapping import render_map  # noqa: E402
from mfslam.settings import load, preset_path  # noqa: E402

# two rooms, a pane of glass, a wall of 10 cm, a pillar, a person who crosses
WORLD = """
wall 0 0 8 0 8 5 0 5 0 0
wall 3.0 2.2 5 2.2 5 2.3 3.0 2.3 3.0 2.2
glass 1 3.8 3 3.8
pillar 6.6 3.6 0.2
person 0.2 0.9 6 0.6 6 4.4
path 1 1
path 7 1.2
path 7.2 2.6
path 5.8 2.9
path 1 3
path 1 1
"""
TURN_RAD = np.radians(20.0)


@pytest.fixture(scope="module", params=["sick-lms200", "rplidar-a1", "utm-30lx"])
def drawn(request):
    """A log drawn from its true poses at 5 and 2 cm, and the truth for each."""
    laser = dataclasses.replace(laser_model(request.param, (0.1, 0.0, 0.0)), mixed_share=0.3)
    world = parse_world(WORLD)
    simulation = simulate(world, RobotModel(), laser, seed=1)
    config = load([preset_path(laser_preset(request.param))])
    beams = beam_truth(world, simulation.motion, laser, simulation.instants_s)
    offsets_s, at = laser.laser.offsets_s, simulation.motion.at
    span_s = max(0.01, float(np.ptp(offsets_s)))
    begin = simulation.instants_s + offsets_s.min()
    twists = se2.log(se2.between(at(begin), at(begin + span_s))) / span_s
    poses = se2.compose(
        np.array([0.0, 0.0, TURN_RAD]), at(simulation.instants_s + reference_offset_s(laser.laser))
    )
    out = {}
    for resolution_m in (0.05, 0.02):
        truth = true_surfaces(world, beams, laser.laser.angles_rad, 0.5 * resolution_m, TURN_RAD)
        settings = config.model_copy(
            update={"map": config.map.model_copy(update={"resolution_m": resolution_m})}
        )
        out[resolution_m] = render_map(simulation.scans, poses, twists, settings)[0], truth
    return out


@pytest.mark.parametrize("resolution_m", [0.05, 0.02])
def test_walls_are_found_and_one_cell_thick(drawn, resolution_m):
    quality = measure_map(*drawn[resolution_m])
    assert quality.found > 0.98
    assert quality.thickness_cells < 1.02 and quality.one_cell > 0.98
    assert quality.error_m < 0.3 * resolution_m + 0.003


@pytest.mark.parametrize("resolution_m", [0.05, 0.02])
def test_people_are_gone_and_glass_is_kept(drawn, resolution_m):
    quality = measure_map(*drawn[resolution_m])
    assert quality.ghosts < 0.02 and quality.far_ghosts < 0.01 * quality.occupied
    assert quality.glass_found > 0.85


@pytest.mark.parametrize("resolution_m", [0.05, 0.02])
def test_space_is_free_up_to_the_walls_and_not_beyond(drawn, resolution_m):
    quality = measure_map(*drawn[resolution_m])
    assert quality.free_to_wall > 0.98
    assert quality.unfilled < 0.01 and quality.false_free < 0.02


def test_the_measures_see_what_is_wrong(drawn):
    grid, truth = drawn[0.05]
    good = measure_map(grid, truth)
    thick, holes, ghosts, leaks = (
        dataclasses.replace(grid, occupancy=grid.occupancy.copy()) for _ in range(4)
    )
    thick.occupancy[1:][(grid.occupancy[:-1] == 100) & (grid.occupancy[1:] != 100)] = 100
    assert measure_map(thick, truth).thickness_cells > 1.4
    holes.occupancy[:, ::4] = 0
    assert measure_map(holes, truth).found < good.found
    free = np.argwhere(grid.occupancy == 0)[::20]
    ghosts.occupancy[free[:, 0], free[:, 1]] = 100
    assert measure_map(ghosts, truth).ghosts > 0.2
    leaks.occupancy[grid.occupancy == -1] = 0
    worse = measure_map(leaks, truth)
    assert worse.leaks > 0.9 and worse.false_free > 0.1
    colours = {tuple(c) for c in np.unique(picture(leaks, truth).reshape(-1, 3), axis=0).tolist()}
    assert {(0, 0, 0), (255, 255, 255), (110, 230, 110)} <= colours
