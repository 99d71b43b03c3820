# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The lens and the bead images against thin-lens numbers and OpenCV."""

import cv2
import numpy as np
import pytest

from mixtac_sim.grids import PADDED, PIXELS, TILE, TILES
from mixtac_sim.mechanics.elastomer import HEMISPHERE
from mixtac_sim.optics.scene import ONE, Lens, Scene, pixel_slopes
from mixtac_sim.pixels.biases import PixelSettings
from mixtac_sim.pixels.dvs import Dvs
from mixtac_sim.world.device import draw_conditions, draw_device
from mixtac_sim.world.effects import preset
from mixtac_sim.world.profiles import make_profile
from mixtac_sim.world.sensor import TactileSensor

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
    return device, device.beads((0.5, -0.8), (HEMISPHERE,))


def test_beads_at_rest_are_where_the_lens_puts_them(motion):
    device, beads = motion
    spots = beads.place(0, 0.0, (0.0, 0.0))
    m = device.markers
    x, y = device.lens.project(m.x_mm, m.y_mm, m.depth_mm)
    np.testing.assert_allclose(spots[:, 0], x, atol=1e-9)
    np.testing.assert_allclose(spots[:, 1], y, atol=1e-9)
    expected = np.hypot(device.lens.softness_px, device.lens.blur_px(m.depth_mm))
    np.testing.assert_allclose(spots[:, 3], expected, rtol=1e-9)


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


def opencv(lens, x, y, depth, roll=0.0):
    """Return what OpenCV makes of points: a pinhole with Brown distortion, rolled by an angle."""
    scale, (column, row) = lens.image_distance_px, lens.centre_px
    points = np.stack([x, y, lens.distance_mm(depth)], axis=1)
    camera = np.array([[scale, 0.0, column], [0.0, scale, row], [0.0, 0.0, 1.0]])
    found, _ = cv2.projectPoints(
        points, np.array([0.0, 0.0, roll]), np.zeros(3), camera, np.array([lens.k1, lens.k2, 0, 0])
    )
    return found[:, 0].T


@pytest.mark.parametrize('seed', range(4))
def test_projection_is_opencvs(seed):
    device = draw_device(seed)
    m = device.markers
    found = np.stack(device.lens.project(m.x_mm, m.y_mm, m.depth_mm))
    expected = opencv(device.lens, m.x_mm, m.y_mm, m.depth_mm)
    np.testing.assert_allclose(found, expected, atol=1e-6)


@pytest.mark.parametrize('name', ['paper_like', 'hard'])
def test_moved_camera_is_opencvs(name):
    device, day = draw_device(2, preset(name)), draw_conditions(5, preset(name))
    lens, m = device.on_day(day).lens, device.markers
    assert lens != device.lens
    expected = opencv(lens, m.x_mm, m.y_mm, m.depth_mm, day.camera_roll_rad)
    found = np.stack(lens.project(m.x_mm, m.y_mm, m.depth_mm))
    np.testing.assert_allclose(found, expected, atol=1e-6)
    # The trial draws the same beads there.
    moved = TactileSensor(2, 5, make_profile('idle', 1, 1.0), preset=preset(name)).device
    assert moved.lens == lens
    beads = moved.beads((0.0, 0.0), (HEMISPHERE,))
    np.testing.assert_allclose(beads.place(0, 0.0, (0.0, 0.0))[:, :2], expected.T, atol=1e-6)


def test_rays_of_a_rolled_camera_undo_its_projection():
    lens = draw_device(2).on_day(draw_conditions(5, preset('hard'))).lens
    slope_x, slope_y = pixel_slopes(lens)
    distance = float(lens.distance_mm(1.0))
    x, y = lens.project(slope_x * distance, slope_y * distance, np.ones_like(slope_x))
    rows, columns = np.mgrid[0:260, 0:346]
    inside = np.hypot(columns - lens.centre_px[0], rows - lens.centre_px[1]) < 165
    np.testing.assert_allclose(x[inside], columns[inside], atol=0.05)
    np.testing.assert_allclose(y[inside], rows[inside], atol=0.05)


def test_overlapping_beads_hide_each_other_as_layers_do():
    # Each lets 1 - c of what is behind it through, so two let (1 - c)^2 through.
    scene = Scene(np.zeros(PADDED, np.float32) + 1.0, np.full(PADDED, 99.0, np.float32))
    dvs = Dvs(scene, draw_device(1).spread, PixelSettings(), np.random.default_rng(0))

    def covered(opacity):
        dvs.settle(np.full(TILES * TILE, round(opacity * ONE), np.int32))
        return (float(dvs.light.ravel()[:PIXELS].mean()) - 1.0) / 99.0

    one, two = covered(0.8), covered(1.6)
    assert one == pytest.approx(1.0 - np.exp(-0.8), abs=0.02)
    assert 1.0 - two == pytest.approx((1.0 - one) ** 2, abs=0.02)
