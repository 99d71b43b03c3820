# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The object as it hangs before anything happens, and the smallest force that holds it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mixtac_sim.contact_steps import STEP_US
from mixtac_sim.errors import SimulationError
from mixtac_sim.grasp.fall import fall
from mixtac_sim.grasp.press import SETTLE_S
from mixtac_sim.grasp.skin import Skin

if TYPE_CHECKING:
    from mixtac_sim.elastomer import Layer
    from mixtac_sim.grasp.objects import GraspSetup

HANG_S = 0.4
"""How long an object must hang to count as held [s]."""
MOVED_MM = 0.02
"""How far it may move in the second half of that [mm]."""
STEP = 1.02
"""Step of the search for the smallest force."""
LOWEST = 0.95
"""Force from which the search goes up, over what the static frictions hold together."""


def hang(
    setup: GraspSetup, layer: Layer, radius_mm: float, force_n: float, surface_seed: int
) -> tuple[Skin, bool]:
    """Let an object hang from skin and wall, loaded alike at first.

    Args:
        setup: The object.
        layer: The gel.
        radius_mm: Contact radius [mm].
        force_n: Normal force [N].
        surface_seed: Draws the object's surface.

    Returns:
        The skin as it then is, and whether the object held.
    """
    rng = np.random.default_rng(surface_seed)
    skin = Skin(layer, radius_mm, setup.friction, rng, round_face=setup.round_face)
    static = setup.friction.static(SETTLE_S)
    skin.rest(setup.weight_n * static / (static + setup.wall_mu), SETTLE_S)
    body = np.zeros(3)
    constants = (*setup.constants()[:4], 2.0 * HANG_S, 1.0, 0.0)
    count = round(0.5e6 * HANG_S / STEP_US)
    path, patches = np.empty((count, 3)), np.empty((count, len(skin.shear_mm)))
    state, gel, law = skin.arrays()
    places = []
    for _ in range(2):
        force = np.full(count, force_n)
        fall(body, constants, state, gel, skin.surface, law, force, path, patches)
        places.append(float(body[1]))
        if places[-1] > 1.0:
            return skin, False
    skin.slid_mm[:] = 0.0
    return skin, places[1] - places[0] < MOVED_MM


def critical_force_n(setup: GraspSetup, layer: Layer, radius_mm: float, surface_seed: int) -> float:
    """Return the smallest force that holds an object, to 2 % [N].

    Arguments are those of ``hang``.

    Raises:
        SimulationError: Not even twice what the static frictions say holds it.
    """
    static = setup.weight_n / (setup.friction.static(SETTLE_S) + setup.wall_mu)
    force = LOWEST * static
    while force < 2.0 * static:
        if hang(setup, layer, radius_mm, force, surface_seed)[1]:
            return force
        force *= STEP
    msg = f'no force up to {force:.2f} N holds {setup}; its surface is too uneven'
    raise SimulationError(msg)
