# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The mesh in view as it sags: geometry, what changes, and what it leaves alone."""

import cv2
import numpy as np
import pytest

from mixtac_sim.grids import HEIGHT, PIXELS, TILE, TILES, WIDTH
from mixtac_sim.optics import scene
from mixtac_sim.optics.scene import Lens, Lighting, MeshMotion, build_scene
from mixtac_sim.pixels.biases import PixelSettings
from mixtac_sim.pixels.dvs import Dvs
from mixtac_sim.world.device import draw_device

LENS = Lens(2.8, 2.0, 13.0, 4.0, 2.0, 0.0, 0.0, (172.5, 129.5))
LIGHT = Lighting(200.0, (0.0, 0.0), 0.0, 0.05, 0.4, 0.15, 0.0, 0.3, (0.2, 0.1), corner_px=1e4)


def image(lit):
    return lit.floor[:PIXELS].reshape(HEIGHT, WIDTH)


def test_mesh_that_comes_closer_is_magnified_about_the_axis(monkeypatch):
    rest = image(build_scene(LENS, LIGHT))
    sag = 0.5
    monkeypatch.setattr(scene, 'SAG_MM', 1e6)
    closer = image(build_scene(LENS, LIGHT, sag_mm=sag))
    growth = 13.0 / (13.0 - sag)
    rows, columns = np.mgrid[0:HEIGHT, 0:WIDTH].astype(np.float32)
    x = ((columns - 172.5) * growth + 172.5).astype(np.float32)
    y = ((rows - 129.5) * growth + 129.5).astype(np.float32)
    back = cv2.remap(closer, x, y, cv2.INTER_CUBIC)
    middle = (slice(60, 200), slice(80, 260))
    # Light falls off with the angle of the ray, which the magnification does not change.
    falloff = cv2.remap(np.ones_like(rest), x, y, cv2.INTER_CUBIC)
    assert falloff[middle].min() > 0.99
    assert np.corrcoef(back[middle].ravel(), rest[middle].ravel())[0, 1] > 0.98
    assert np.corrcoef(closer[middle].ravel(), rest[middle].ravel())[0, 1] < 0.95


@pytest.fixture(scope='module')
def parts():
    device = draw_device(4)
    dvs = Dvs(device.scene, device.spread, PixelSettings(), np.random.default_rng(0))
    return device, dvs, MeshMotion(device.lens, device.lighting, device.mesh_n_per_mm, (1.0, 0.5))


def show(mesh, dvs, dirty, elastic_n):
    dvs.blend(mesh, mesh.level(elastic_n))
    dirty[mesh.tiles] = 1


def test_pixels_see_the_mesh_where_the_load_puts_it(parts):
    device, dvs, mesh = parts
    dirty = np.zeros(TILES, np.uint8)
    force = 0.22 * device.mesh_n_per_mm
    show(mesh, dvs, dirty, force)
    assert 0.3 < dirty.mean() < 1.0
    dvs.settle(np.zeros(TILES * TILE, np.int32))
    sagged = build_scene(device.lens, device.lighting, (1.0, 0.5), 0.22)
    seen = dvs.light.ravel()[:PIXELS]
    np.testing.assert_allclose(seen, sagged.floor[:PIXELS], rtol=0.02, atol=0.3)
    dirty[:] = 0
    assert mesh.level(force + 0.001 * device.mesh_n_per_mm) is None
    assert not dirty.any()
    show(mesh, dvs, dirty, 0.0)
    dvs.settle(np.zeros(TILES * TILE, np.int32))
    np.testing.assert_allclose(dvs.light.ravel()[:PIXELS], device.scene.floor[:PIXELS], rtol=1e-6)
