# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The force law against Hayes' flat punch, Hertz's sphere and an independent table."""

import numpy as np
import pytest

from mixtac_sim.mechanics.elastomer import HEMISPHERE, Indenter, Layer, force_law
from mixtac_sim.mechanics.layer import punch_factor, surface_mobility

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


def test_mobility_has_both_limits():
    t = np.array([1e-3, 1e-2, 0.0199, 0.0201, 15.0, 19.9, 25.0])
    mobility = surface_mobility(t)
    np.testing.assert_allclose(mobility[:4], 2.0 / 3.0 * t[:4] ** 3, rtol=2e-3)
    np.testing.assert_allclose(mobility[4:], 1.0, atol=1e-6)
