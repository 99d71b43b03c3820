# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The layer under a pull and a turn, against the half-space, a disc and the balance of forces."""

import numpy as np
import pytest

from mixtac_sim.mechanics.elastomer import Layer, Shear
from mixtac_sim.mechanics.layer import FIELD_RADII, shear_field


def test_a_pull_moves_every_height_by_what_a_layer_in_shear_would_together():
    """Every wave but the longest cancels: int u dA = F z / G, whatever the contact."""
    height = np.array([0.2, 0.5, 0.8])
    for alpha in (0.1, 0.5, 1.0, 2.0):
        along = shear_field().at(alpha, height[:, None], FIELD_RADII)[..., 0]
        # In units of F / (2 pi G h).
        total = np.trapezoid(along * FIELD_RADII, FIELD_RADII, axis=1)
        np.testing.assert_allclose(total, height, rtol=0.04)


def test_a_pull_on_a_small_contact_is_cerruti_s_point_force():
    """Incompressible half-space: u = F / (4 pi G R) (1 + x^2 / R^2), w = F x d / (4 pi G R^3)."""
    deep = 0.1
    for away in (0.0, 0.0625, 0.125):
        along, lobes, rise, _ = shear_field().at(0.02, np.array([1.0 - deep]), away)[0]
        distance = np.hypot(deep, away)
        unit, ahead = 0.5 / distance, (away / distance) ** 2
        # The base, ten times as far away, takes some of what all points share.
        assert 0.25 < unit * (1.0 + 0.5 * ahead) - along < 0.5
        assert lobes == pytest.approx(0.5 * unit * ahead, rel=0.06, abs=1e-6)
        assert rise == pytest.approx(-unit * away * deep / distance**2, rel=0.06, abs=1e-6)


@pytest.mark.parametrize('alpha', [0.4, 0.6, 1.0, 1.5])
def test_the_skin_under_a_pull_moves_as_far_as_the_spring_of_the_sliding_contact(alpha):
    layer = Layer(150.0, 4.0)
    skin = shear_field().at(alpha, 1.0, np.linspace(0.0, 0.8 * alpha, 9))[:, 0].mean()
    compliance = skin / (2.0 * np.pi * 0.05 * layer.thickness_mm)
    radius = np.array([alpha * layer.thickness_mm])
    spring = Shear(layer, 0.6, (0.0, 0.0)).stiffness(radius)[0]
    assert compliance * spring == pytest.approx(1.0, abs=0.2)


def test_a_turn_is_that_of_reissner_and_sagoci_on_the_skin_and_dies_out_below():
    turn = shear_field().at(0.5, np.array([1.0, 0.75, 0.5]), 0.2)[:, 3]
    assert turn[0] == pytest.approx(1.0, abs=0.05)
    assert turn[0] > 2.0 * turn[1] > 4.0 * turn[2]
