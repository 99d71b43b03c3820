# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The lens against thin-lens numbers, and the bead images against the lens."""

import numpy as np
import pytest

from mixtac_sim.mechanics.elastomer import HEMISPHERE, force_law
from mixtac_sim.optics.scene import Lens
from mixtac_sim.world.device import draw_device

LENS = Lens(2.8, 2.0, 15.0, 1e-6, 0.0, 0.0, 0.0, (173.0, 130.0))


def test_scale_is_that_of_a_thin_lens():
    # f = 2.8 mm, u = 15 mm: 12.4 px/mm (paraxial, 18.5 um pixels).
    x, _ = LENS.project(np.array([0.0, 1.0]), np.zeros(2), np.zeros(2))
    assert x[1] - x[0] == pytest.approx(12.4, rel=0.01)


def test_blur_grows_by_the_known_rate():
    # N = 2: 1.1 px per mm of defocus; an apparent mm is 1.41 mm of silicone.
    lens = Lens(2.8, 2.0, 15.0 - 2.0 / 1.41, 4.0, 2.0, 0.0, 0.0, (173.0, 130.0))
    assert float(lens.blur_px(2.0)) == pytest.approx(0.0, abs=1e-9)
    assert float(lens.blur_px(2.0 - 1.41)) == pytest.approx(1.1, rel=0.1)


@pytest.fixture(scope='module')
def motion():
    device = draw_device(5)
    law = force_law(device.layer, HEMISPHERE, device.mesh_n_per_mm)
    return device, device.beads(device.layer, (0.5, -0.8), (HEMISPHERE,), [law])


def test_beads_at_rest_are_where_the_lens_puts_them(motion):
    device, beads = motion
    spots = beads.place(0, 0.0, (0.0, 0.0))
    m = device.markers
    x, y = device.lens.project(m.x_mm, m.y_mm, m.depth_mm)
    np.testing.assert_allclose(spots[:, 0], x, atol=1e-9)
    np.testing.assert_allclose(spots[:, 1], y, atol=1e-9)
    expected = np.hypot(device.lens.softness_px, device.lens.blur_px(m.depth_mm))
    np.testing.assert_allclose(spots[:, 3], expected, rtol=1e-9)


def test_bead_size_is_that_of_its_projection(motion):
    device, beads = motion
    spots = beads.place(0, 0.0, (0.0, 0.0))
    m, lens = device.markers, device.lens
    right, _ = lens.project(m.x_mm + 0.4, m.y_mm, m.depth_mm)
    left, _ = lens.project(m.x_mm - 0.4, m.y_mm, m.depth_mm)
    near = np.hypot(m.x_mm, m.y_mm) < 6.0
    np.testing.assert_allclose(spots[near, 2], 0.5 * (right - left)[near], rtol=0.06)


def test_press_moves_beads_outwards_by_pixels(motion):
    device, beads = motion
    rest = beads.place(0, 0.0, (0.0, 0.0)).copy()
    pressed = beads.place(0, 1.0, (0.0, 0.0))
    moved = np.hypot(*(pressed - rest)[:, :2].T)
    assert 0.8 < moved.max() < 6.0
    assert moved.max() == pytest.approx(float(beads.reach_px(0, np.array(1.0))), rel=0.05)
    away = np.stack([device.markers.x_mm - 0.5, device.markers.y_mm + 0.8])
    largest = np.argsort(moved)[-20:]
    outwards = np.sum((pressed - rest)[largest, :2] * away.T[largest], axis=1)
    assert np.all(outwards > 0.0)


def test_shear_moves_all_of_the_contact_one_way(motion):
    _, beads = motion
    rest = beads.place(0, 0.5, (0.0, 0.0)).copy()
    sheared = beads.place(0, 0.5, (0.2, 0.0))
    shift = (sheared - rest)[:, 0]
    # What lies ahead of a pull sinks, and comes nearer to the lens by a hair.
    assert shift.min() > -0.02 * shift.max()
    assert 0.5 < shift.max() < 0.2 * 1.3 * beads.px_per_mm


def test_beads_do_not_interpenetrate():
    m = draw_device(7).markers
    places = np.stack([m.x_mm, m.y_mm, m.depth_mm])
    apart = np.linalg.norm(places[:, :, None] - places[:, None, :], axis=0)
    assert np.min(apart + 10.0 * np.eye(len(m.x_mm))) > 0.8
