# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Shear against Coulomb's limit and Mindlin's curve."""

import numpy as np
import pytest

from mixtac_sim.mechanics.elastomer import Layer, Shear

LAYER = Layer(150.0, 4.0)
FORCE, RADIUS = np.full(50, 0.8), np.full(50, 2.5)
DEPTH = np.linspace(0.0, 1.5, 50)


def pull(friction, lean=0.5, **more):
    return Shear(LAYER, friction, (lean, 0.0), **more).at(FORCE, DEPTH, RADIUS)


def test_stick_is_linear_up_to_the_limit():
    moved, force = pull(0.6)
    stiffness = 0.05 * np.pi * 4.5**2 / 4.0  # G A / h, N/mm
    np.testing.assert_allclose(force[:, 0], np.minimum(stiffness * 0.5 * DEPTH, 0.48), rtol=1e-9)
    np.testing.assert_allclose(force[:, 0], stiffness * moved[:, 0], rtol=1e-9)
    assert np.all(force[:, 1] == 0.0)


def test_partial_slip_is_mindlins_curve():
    _, force = pull(0.6, 0.8, partial_slip=True)
    limit, stiffness = 0.48, 0.05 * np.pi * 4.5**2 / 4.0
    inside = (force[:, 0] < 0.999 * limit) & (DEPTH > 0.0)
    # Displacement over that of full slip, 1 - (1 - Q / mu F)^(2/3); full slip at 1.5 mu F / k.
    share = 1.0 - (1.0 - force[inside, 0] / limit) ** (2.0 / 3.0)
    np.testing.assert_allclose(share * 1.5 * limit / stiffness, 0.8 * DEPTH[inside], rtol=1e-6)
    assert force[-1, 0] == pytest.approx(limit)
    assert force[1, 0] == pytest.approx(stiffness * 0.8 * DEPTH[1], rel=0.05)


def test_friction_falls_with_the_load():
    light = Shear(LAYER, 0.6, (5.0, 0.0), 1.0 / 3.0)
    force_n = np.array([0.1, 1.0, 8.0])
    _, force = light.at(force_n, np.full(3, 3.0), np.full(3, 2.5))
    np.testing.assert_allclose(force[:, 0] / force_n, [0.6 * 0.1 ** (-1 / 3), 0.6, 0.3], rtol=1e-9)


@pytest.mark.parametrize('slip', [False, True])
def test_nothing_pulls_without_a_load(slip):
    moved, force = Shear(LAYER, 0.6, (0.1, 0.2), 0.3, partial_slip=slip).at(
        np.zeros(3), np.array([0.0, 0.1, 0.2]), np.zeros(3)
    )
    assert np.all(force == 0.0)
    assert np.all(moved == 0.0)
