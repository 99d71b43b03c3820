# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The edge's contact solver against solutions it does not share, and the field below an edge."""

import numpy as np
import pytest

from mixtac_sim.mechanics import layer as edge_contact
from mixtac_sim.mechanics.elastomer import HEMISPHERE, INDENTERS, Layer, force_law
from mixtac_sim.mechanics.layer import solve_edge

EDGE = INDENTERS['edge']
THICKNESS = 4.25


@pytest.fixture(scope='module')
def contact():
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
    # Half width of a Hertzian line contact, and the peak pressure 2 F / (pi a L).
    found = solve_edge(1.0, 12.0, 12.0)
    row = int(np.searchsorted(found.depth_mm, 0.3))
    per_mm = 1e3 * found.force_n[row] / 12.0  # kPa mm at 1 kPa
    half_width = np.sqrt(4.0 * per_mm * 1.0 / (np.pi * 4.0 / 3.0))
    pressure = edge_contact.irfft2(found.spectra[row], edge_contact.SHAPE)
    middle = pressure[:, 48]
    assert 0.05 * np.count_nonzero(middle > 1e-9) == pytest.approx(half_width, rel=0.15)
    assert middle.max() == pytest.approx(2.0 * per_mm / (np.pi * half_width), rel=0.15)


def test_nothing_pulls_and_the_skin_follows_the_edge(contact):
    row = 12
    pressure = edge_contact.irfft2(contact.spectra[row], edge_contact.SHAPE)
    assert pressure.min() > -1e-9
    along = np.linspace(-4.0, 4.0, 9)
    moved = contact.displacements(along, np.zeros(9), np.ones(9))[row]
    np.testing.assert_allclose(moved[:, 2], contact.depth_mm[row], rtol=0.01)


def test_field_ends_at_the_mesh_and_bulges_beside_the_edge(contact):
    across = np.array([0.0, 0.5, 3.0, 5.0])
    base = contact.displacements(np.zeros(4), across, np.zeros(4))[-1]
    assert np.abs(base).max() < 1e-9
    skin = contact.displacements(np.zeros(4), across, np.ones(4))[-1]
    assert skin[2:, 2].max() < 0.0
    middle = contact.displacements(np.zeros(4), across, np.full(4, 0.5))[-1]
    assert np.all(middle[1:, 1] > 0.0)  # outwards
    assert np.abs(middle[:, 0]).max() < 0.1 * middle[:, 1].max()


def test_volume_is_kept(contact):
    # What the skin loses within a strip goes out through its sides, over the whole height.
    reach, x = 2.0, np.zeros(1)
    heights, y = np.linspace(0.0, 1.0, 41), np.linspace(-reach, reach, 81)
    down = contact.displacements(np.repeat(x, 81), y, np.ones(81))[-1, :, 2]
    out = contact.displacements(np.repeat(x, 41), np.full(41, reach), heights)[-1, :, 1]
    ends = [
        contact.displacements(np.full(81 * 41, s), np.tile(y, 41), np.repeat(heights, 81))[-1, :, 0]
        for s in (-0.5, 0.5)
    ]
    squeezed = np.trapezoid(down, y)
    sides = 2.0 * THICKNESS * np.trapezoid(out, heights)
    lengthwise = np.trapezoid(
        np.trapezoid((ends[1] - ends[0]).reshape(41, 81), y, axis=1), THICKNESS * heights
    )
    assert squeezed == pytest.approx(sides + lengthwise, rel=0.05)
