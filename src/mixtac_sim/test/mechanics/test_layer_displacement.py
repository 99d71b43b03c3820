# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The field in the layer against a table, incompressibility and its boundary conditions."""

import numpy as np
import pytest

from mixtac_sim.mechanics.elastomer import HEMISPHERE, Layer, force_law
from mixtac_sim.mechanics.layer import displacement_field

# 1 N, E = 200 kPa, h = 5 mm: depth below the skin, displacement inwards on the axis, largest
# displacement outwards [mm].
TABLE = [(0, 0.60, 0.06), (1, 0.48, 0.15), (2, 0.30, 0.14), (3, 0.15, 0.12), (4, 0.045, 0.07)]
H = 5.0
MM = 1.0 / (0.2 * H)  # F / (E h)


@pytest.fixture(scope='module')
def contact():
    law = force_law(Layer(200.0, H), HEMISPHERE)
    return law.depth_at(1.0), float(law.radius_at(1.0)) / H


def at(alpha, depth, radius):
    place = 1.0 - np.asarray(depth) / H, np.asarray(radius) / H
    return MM * np.moveaxis(displacement_field('sphere').at(np.array(alpha), *place), -1, 0)


@pytest.mark.parametrize(('depth', 'axis', 'outwards'), TABLE)
def test_check_values(contact, depth, axis, outwards):
    radius = np.linspace(0.0, 8.0, 161)
    inward, outward = at(contact[1], depth, radius)
    assert inward[0] == pytest.approx(axis, rel=0.1)
    assert outward.max() == pytest.approx(outwards, rel=0.1)


def test_skin_follows_the_sphere(contact):
    radius = np.linspace(0.0, 0.9 * contact[1] * H, 20)
    inward, _ = at(contact[1], 0.0, radius)
    np.testing.assert_allclose(inward, contact[0] - radius**2 / 18.0, atol=0.01)


def test_nothing_moves_at_the_mesh(contact):
    inward, outward = at(contact[1], H, np.linspace(0.0, 20.0, 50))
    assert np.abs(inward).max() == 0.0
    assert np.abs(outward).max() == 0.0


def test_skin_bulges_outside_the_contact(contact):
    inward, _ = at(contact[1], 0.0, np.linspace(5.5, 9.0, 20))
    assert np.all(inward < 0.0)
    assert inward.min() == pytest.approx(-0.03, abs=0.006)


@pytest.mark.parametrize('radius', [2.0, 4.0, 8.0, 15.0])
def test_volume_pushed_in_flows_out(contact, radius):
    inside = np.linspace(0.0, radius, 801)
    pushed, _ = at(contact[1], 0.0, inside)
    depth = np.linspace(0.0, H, 401)
    _, outward = at(contact[1], depth, np.full(401, radius))
    volume = np.trapezoid(pushed * inside, inside)
    assert volume == pytest.approx(radius * np.trapezoid(outward, depth), rel=0.02)


def test_displacement_is_proportional_to_force_for_small_contacts():
    near, _ = at(0.02, 3.0, [0.0, 2.0])
    wider, _ = at(0.05, 3.0, [0.0, 2.0])
    np.testing.assert_allclose(near, wider, rtol=0.01)


def test_flat_face_moves_the_skin_evenly():
    field = displacement_field('flat')
    inward = field.at(np.array(1.2), np.array(1.0), np.linspace(0.0, 1.0, 11))[:, 0]
    # Truncating the spectrum rounds the corner of the face and rings a little inside it.
    assert np.ptp(inward) < 0.04 * inward.mean()
