# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The field in the layer under spheres, edges, pulls and turns, against solutions of its own."""

import numpy as np
import pytest

from mixtac_sim.mechanics import layer as edge_contact
from mixtac_sim.mechanics.elastomer import HEMISPHERE, INDENTERS, Layer, Shear, force_law
from mixtac_sim.mechanics.layer import FIELD_RADII, displacement_field, shear_field, solve_edge

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


@pytest.mark.parametrize('radius', [2.0, 4.0, 8.0, 15.0])
def test_volume_pushed_in_flows_out(contact, radius):
    inside = np.linspace(0.0, radius, 801)
    pushed, _ = at(contact[1], 0.0, inside)
    depth = np.linspace(0.0, H, 401)
    _, outward = at(contact[1], depth, np.full(401, radius))
    volume = np.trapezoid(pushed * inside, inside)
    assert volume == pytest.approx(radius * np.trapezoid(outward, depth), rel=0.02)


EDGE = INDENTERS['edge']
THICKNESS = 4.25


@pytest.fixture(scope='module')
def pressed():
    return solve_edge(EDGE.radius_mm, EDGE.length_mm, THICKNESS)


@pytest.mark.parametrize('depth', [0.2, 0.4, 0.6])
def test_sphere_on_the_grid_is_the_one_of_the_integral_equation(depth, monkeypatch):
    # A ball has a solution by a dual integral equation, which knows no grid.
    rows, columns = np.mgrid[0:240, 0:96]
    gap = (np.square(0.1 * (rows - 120)) + np.square(0.25 * (columns - 48))) / 18.0
    monkeypatch.setattr(edge_contact, '_gap', lambda *_: gap)
    monkeypatch.setattr(edge_contact, 'DEEPEST', depth / 5.0)
    found = solve_edge.__wrapped__(EDGE.radius_mm, EDGE.length_mm, 5.0)
    law = force_law(Layer(200.0, 5.0), HEMISPHERE)
    force = law.force_at(depth)
    assert 200.0 * found.force_n[-1] == pytest.approx(force, rel=0.03)
    assert found.radius_mm[-1] == pytest.approx(float(law.radius_at(force)), rel=0.04)


def test_long_edge_on_a_thick_layer_presses_as_hertz_says():
    # Half width of a Hertzian line pressed, and the peak pressure 2 F / (pi a L).
    found = solve_edge(1.0, 12.0, 12.0)
    row = int(np.searchsorted(found.depth_mm, 0.3))
    per_mm = 1e3 * found.force_n[row] / 12.0  # kPa mm at 1 kPa
    half_width = np.sqrt(4.0 * per_mm * 1.0 / (np.pi * 4.0 / 3.0))
    pressure = edge_contact.irfft2(found.spectra[row], edge_contact.SHAPE)
    middle = pressure[:, 48]
    assert 0.05 * np.count_nonzero(middle > 1e-9) == pytest.approx(half_width, rel=0.15)
    assert middle.max() == pytest.approx(2.0 * per_mm / (np.pi * half_width), rel=0.15)


def test_volume_is_kept(pressed):
    # What the skin loses within a strip goes out through its sides, over the whole height.
    reach, x = 2.0, np.zeros(1)
    heights, y = np.linspace(0.0, 1.0, 41), np.linspace(-reach, reach, 81)
    down = pressed.displacements(np.repeat(x, 81), y, np.ones(81))[-1, :, 2]
    out = pressed.displacements(np.repeat(x, 41), np.full(41, reach), heights)[-1, :, 1]
    ends = [
        pressed.displacements(np.full(81 * 41, s), np.tile(y, 41), np.repeat(heights, 81))[-1, :, 0]
        for s in (-0.5, 0.5)
    ]
    squeezed = np.trapezoid(down, y)
    sides = 2.0 * THICKNESS * np.trapezoid(out, heights)
    lengthwise = np.trapezoid(
        np.trapezoid((ends[1] - ends[0]).reshape(41, 81), y, axis=1), THICKNESS * heights
    )
    assert squeezed == pytest.approx(sides + lengthwise, rel=0.05)


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
