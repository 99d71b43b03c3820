# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The force law against published numbers, stiffening, and shear against Coulomb and Mindlin."""

import numpy as np
import pytest

from mixtac_sim.mechanics.elastomer import HEMISPHERE, Indenter, Layer, Shear, force_law
from mixtac_sim.mechanics.layer import punch_factor

# Flat punch on a bonded incompressible layer: Hayes et al. 1972 give 1.281, 3.609 and 9.069 for
# 0.2, 1 and 2; the others are from a separate solution of the same equation.
KAPPA = {0.2: 1.281, 0.4: 1.684, 0.6: 2.213, 0.8: 2.86, 1.0: 3.62, 1.5: 6.00, 2.0: 9.15}

# E [kPa], h [mm], depth [mm] at 0.2 N and 1 N, stiffness at 1 N [N/mm], exponent at 1 N.
TABLE = [
    (100, 3, 0.30, 0.64, 3.5, 2.18),
    (100, 5, 0.37, 0.85, 2.4, 2.01),
    (150, 3, 0.24, 0.53, 4.2, 2.14),
    (150, 5, 0.29, 0.70, 2.9, 1.96),
    (180, 3, 0.22, 0.49, 4.5, 2.12),
    (180, 4, 0.25, 0.57, 3.6, 2.02),
    (180, 5, 0.26, 0.63, 3.1, 1.93),
    (180, 6, 0.28, 0.68, 2.8, 1.87),
    (280, 3, 0.17, 0.39, 5.4, 2.07),
    (280, 5, 0.20, 0.50, 3.8, 1.88),
]


@pytest.mark.parametrize(('alpha', 'kappa'), KAPPA.items())
def test_flat_punch_factor(alpha, kappa):
    assert punch_factor(alpha) == pytest.approx(kappa, rel=0.01)


@pytest.mark.parametrize(('modulus', 'thickness', 'at_02', 'at_1', 'stiffness', 'power'), TABLE)
def test_hemisphere_table(modulus, thickness, at_02, at_1, stiffness, power):
    law = force_law(Layer(modulus, thickness), HEMISPHERE)
    assert law.depth_at(0.2) == pytest.approx(at_02, rel=0.03)
    depth = law.depth_at(1.0)
    assert depth == pytest.approx(at_1, rel=0.03)
    slope = (law.force_at(1.02 * depth) - law.force_at(0.98 * depth)) / (0.04 * depth)
    assert slope == pytest.approx(stiffness, rel=0.04)
    assert slope * depth == pytest.approx(power, rel=0.03)


def test_thick_layer_is_a_half_space():
    modulus, depth = 200.0, 0.05
    law = force_law(Layer(modulus, 40.0), Indenter('sphere', 2.0))
    hertz = 16.0 / 9.0 * 1e-3 * modulus * np.sqrt(2.0) * depth**1.5
    assert law.force_at(depth) == pytest.approx(hertz, rel=0.03)
    assert law.radius_at(law.force_at(depth)) == pytest.approx(np.sqrt(2.0 * depth), rel=0.03)


def test_mesh_is_a_spring_in_series():
    layer = Layer(160.0, 4.0)
    alone, on_mesh = force_law(layer, HEMISPHERE), force_law(layer, HEMISPHERE, 5.0)
    for force in (0.05, 0.3, 1.0, 3.0):
        assert on_mesh.depth_at(force) == pytest.approx(
            alone.depth_at(force) + force / 5.0, rel=2e-3
        )


LAYER = Layer(180.0, 4.0)


@pytest.mark.parametrize('stiffening', [0.5, 3.0])
def test_large_strains_stay_below_those_of_rubber_in_compression(stiffening):
    # A neo-Hookean block has (1 / l^2 - l) / (3 (1 - l)) times the linear stress, l = 1 - strain.
    linear, stiff = force_law(LAYER, HEMISPHERE), force_law(LAYER, HEMISPHERE, np.inf, stiffening)
    for strain in (0.2, 0.3, 0.4):
        depth, left = 4.0 * strain, 1.0 - strain
        gain = stiff.force_at(depth) / linear.force_at(depth)
        assert gain == pytest.approx(1.0 + stiffening * strain**2, rel=0.01)
        assert gain < (left**-2 - left) / (3.0 * strain)


SOFT = Layer(150.0, 4.0)
FORCE, RADIUS = np.full(50, 0.8), np.full(50, 2.5)
DEPTH = np.linspace(0.0, 1.5, 50)


def pull(friction, lean=0.5, **more):
    return Shear(SOFT, friction, (lean, 0.0), **more).at(FORCE, DEPTH, RADIUS)


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
    light = Shear(SOFT, 0.6, (5.0, 0.0), 1.0 / 3.0)
    force_n = np.array([0.1, 1.0, 8.0])
    _, force = light.at(force_n, np.full(3, 3.0), np.full(3, 2.5))
    np.testing.assert_allclose(force[:, 0] / force_n, [0.6 * 0.1 ** (-1 / 3), 0.6, 0.3], rtol=1e-9)
