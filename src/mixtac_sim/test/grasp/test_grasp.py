# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The held object: weight, knock and fall against mechanics by hand."""

from dataclasses import replace

import numpy as np
import pytest

from mixtac_sim import SimulationError
from mixtac_sim.grasp.grasp import Grasp, hold
from mixtac_sim.grasp.objects import (
    OBJECTS,
    WALL_KINETIC,
    Friction,
    GraspSetup,
    draw_setup,
)
from mixtac_sim.grasp.skin import Press
from mixtac_sim.mechanics.contact import GRAVITY
from mixtac_sim.mechanics.elastomer import shear_stiffness
from mixtac_sim.world.device import draw_device

SETUP = GraspSetup('box', 80.0, 50.0, Friction(roughness=0.0), 0.5, 1.05, 50.0, 1e-3, 0.01)


def _run(setup: GraspSetup, seconds: float, advance_mm: float = 0.0) -> tuple[Grasp, np.ndarray]:
    grasp = Grasp(setup, 1, 1, camera=False)
    count = round(seconds / 125e-6)
    block = grasp.advance(np.full(count, advance_mm))
    return grasp, np.stack([block.object_mm, block.speed_mm_s, block.pull_n, block.normal_n])


def test_hangs_still_without_a_knock() -> None:
    for name in OBJECTS:
        setup = draw_setup(name, np.random.default_rng(3), knock_mm_s=0.0)
        _, path = _run(setup, 0.3)
        assert path[0, -1] < 0.03


def test_open_loop_falls_at_small_margin_and_not_at_large() -> None:
    _, path = _run(SETUP, 0.4)
    assert path[0, -1] > 5.0
    _, path = _run(replace(SETUP, margin=1.5), 0.4)
    assert path[0, -1] < 1.0
    assert path[1, -1] == 0.0


def test_the_knock_brings_its_speed() -> None:
    # Over 1 ms friction changes the speed by no more than a few percent.
    _, path = _run(replace(SETUP, knock_mm_s=200.0), 0.0115)
    assert path[1].max() == pytest.approx(200.0, rel=0.06)


def test_falls_as_weight_less_friction_says() -> None:
    setup = replace(SETUP, margin=0.9)
    grasp, path = _run(setup, 0.3)
    mass = 80e-3
    late = slice(-400, None)
    slope = np.polyfit(np.arange(400) * 125e-6, path[1, late], 1)[0]
    wall = WALL_KINETIC * 0.5 * path[3, late].mean()
    expected = 1e3 * (mass * GRAVITY - path[2, late].mean() - wall) / mass
    assert slope == pytest.approx(expected, rel=0.02)
    assert grasp.grasp_n == pytest.approx(0.9 * grasp.critical_n)


def test_critical_force_is_near_what_the_frictions_say() -> None:
    grasp = Grasp(SETUP, 1, 1, camera=False)
    static = SETUP.friction.static(3.0) + SETUP.wall_mu
    assert grasp.critical_n == pytest.approx(SETUP.weight_n / static, rel=0.06)


@pytest.mark.parametrize(('name', 'grows'), [('ball', True), ('box', False)])
def test_the_skin_is_as_stiff_as_the_gel_under_the_contact_at_that_force(
    name: str, grows: bool
) -> None:
    """The beads show the pull by that stiffness."""
    device = draw_device(1)
    found = []
    for force in (0.3, 0.9):
        press = Press(device, OBJECTS[name].face, 50.0, force)
        skin, _ = hold(replace(SETUP, name=name), press, force, 1)
        radius = float(press.gel.radius_at(press.elastic_n))
        found.append(float(skin.stiffness.sum()))
        assert found[-1] == pytest.approx(shear_stiffness(device.layer, radius))
    assert (found[1] > 1.1 * found[0]) == grows


def test_pressing_harder_stops_the_fall() -> None:
    _, free = _run(SETUP, 0.3)
    grasp = Grasp(SETUP, 1, 1, camera=False)
    way = np.zeros(2400)
    way[120:] = 0.1
    block = grasp.advance(way)
    more_n = 0.1 * grasp.stiffness_n_per_mm
    assert block.normal_n[-1] == pytest.approx(grasp.grasp_n + more_n, rel=0.1)
    assert block.object_mm[-1] < 0.2 * free[0, -1]
    assert block.speed_mm_s[-1] == 0.0


def test_refuses_what_does_not_exist() -> None:
    with pytest.raises(SimulationError):
        draw_setup('egg', np.random.default_rng(0))


@pytest.mark.parametrize('cut', [8, 20])
def test_same_trial_however_it_is_cut(cut: int) -> None:
    whole = Grasp(SETUP, 1, 1, camera=False).advance(np.zeros(160)).object_mm
    grasp = Grasp(SETUP, 1, 1, camera=False)
    parts = [grasp.advance(np.zeros(cut)).object_mm for _ in range(160 // cut)]
    assert np.array_equal(np.concatenate(parts), whole)
