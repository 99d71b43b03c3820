# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Discs, the mesh that sags, and a lamp that ripples."""

import cv2
import numpy as np
import pytest

from mixtac_sim.grids import HEIGHT, PADDED, PIXELS, TILE, TILES, WIDTH
from mixtac_sim.optics import scene
from mixtac_sim.optics.scene import (
    ONE,
    Flicker,
    Lens,
    Lighting,
    MeshMotion,
    Renderer,
    Scene,
    build_scene,
)
from mixtac_sim.pixels.biases import PixelSettings, PixelSpread
from mixtac_sim.pixels.dvs import Dvs
from mixtac_sim.world.device import draw_device


def spots(*rows):
    return np.array(rows, np.float64)


def image(renderer):
    return renderer.cover[:PIXELS].reshape(HEIGHT, WIDTH) / ONE


def test_moving_there_and_back_leaves_no_trace():
    rng = np.random.default_rng(1)
    renderer = Renderer(rng.uniform(1.0, 3.0, 50))
    home = np.column_stack(
        [rng.uniform(-5, 350, 50), rng.uniform(-5, 265, 50), np.full(50, 5.0), np.full(50, 2.0)]
    )
    renderer.draw(home)
    before = renderer.cover.copy()
    for _ in range(20):
        renderer.draw(home + rng.normal(0.0, 1.0, home.shape) * [1, 1, 0.1, 0.1])
    renderer.draw(home)
    np.testing.assert_array_equal(renderer.cover, before)


def test_disc_is_where_it_was_put():
    renderer = Renderer(np.array([2.0]))
    renderer.draw(spots((100.3, 80.7, 5.0, 2.0)))
    drawn = image(renderer)
    rows, columns = np.mgrid[0:HEIGHT, 0:WIDTH]
    assert np.isclose((drawn * columns).sum() / drawn.sum(), 100.3, atol=0.02)
    assert np.isclose((drawn * rows).sum() / drawn.sum(), 80.7, atol=0.02)
    assert np.isclose(drawn[81, 100], 2.0, rtol=0.02)
    assert drawn[81, 108] == 0.0


def test_only_tiles_that_changed_are_marked():
    renderer = Renderer(np.array([2.0, 2.0]))
    renderer.draw(spots((100.0, 80.0, 5.0, 2.0), (200.0, 200.0, 5.0, 2.0)))
    renderer.dirty[:] = 0
    before = renderer.cover.copy()
    renderer.draw(spots((101.0, 80.0, 5.0, 2.0), (200.0, 200.0, 5.0, 2.0)))
    changed = np.flatnonzero((renderer.cover != before).reshape(-1, TILE).any(axis=1))
    assert set(changed) <= set(np.flatnonzero(renderer.dirty))
    assert 0 < renderer.dirty.sum() < 60


LENS = Lens(2.8, 2.0, 13.0, 4.0, 2.0, 0.0, 0.0, (172.5, 129.5))
LIGHT = Lighting(200.0, (0.0, 0.0), 0.0, 0.05, 0.4, 0.15, 0.0, 0.3, (0.2, 0.1), corner_px=1e4)


def lit_image(lit):
    return lit.floor[:PIXELS].reshape(HEIGHT, WIDTH)


def test_mesh_that_comes_closer_is_magnified_about_the_axis(monkeypatch):
    rest = lit_image(build_scene(LENS, LIGHT))
    sag = 0.5
    monkeypatch.setattr(scene, 'SAG_MM', 1e6)
    closer = lit_image(build_scene(LENS, LIGHT, sag_mm=sag))
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


QUIET = {'leak_hz': 0.0, 'leak_hz_per_lux': 0.0, 'shot_hz': 0.0, 'refractory_us': 0.0}
ONES = np.ones(PADDED, np.float32)
EVEN = PixelSpread(ONES, ONES, ONES, np.array([7]), np.array([0.0]))


def events_under(lamp, settings, lux, seconds=0.2, step_us=500, warm_s=0.1, touched=lambda _: True):
    """Return times [s], pixels and polarities of events after a warm-up.

    In the steps for which `touched` is true, something wakes all tiles.
    """
    scene = Scene(np.full(PADDED, lux, np.float32), np.zeros(PADDED, np.float32))
    dvs = Dvs(scene, EVEN, settings, np.random.default_rng(0))
    dvs.light_by(lamp)
    cover, dirty = np.zeros(PADDED, np.int32), np.ones(TILES, np.uint8)
    found, ns = [], 1000 * step_us
    for k in range(round((warm_s + seconds) * 1e6 / step_us)):
        dirty[:] = touched(k)
        dvs.step(cover, dirty, k * ns, (k + 1) * ns, 0)
        keys = dvs.take()
        if k * step_us >= 1e6 * warm_s:
            found.append(keys)
    keys = np.concatenate(found)
    return 1e-9 * (keys >> 18), (keys >> 1) & 0x1FFFF, keys & 1


@pytest.mark.parametrize('lux', [20.0, 200.0])
def test_ripple_reaches_pixels_through_their_bandwidth(lux):
    settings = PixelSettings(0.006, 0.006, 1e5, 2.5, **QUIET)
    lamp = Flicker(0.05, 0.0)
    _, _, on = events_under(lamp, settings, lux, seconds=0.05, warm_s=0.05, step_us=250)
    # The climb per period of ln(1 + m sin) through a first-order pixel of 2.5 Hz/lx.
    t = np.linspace(0.0, 1.0, 4096, endpoint=False)
    waves = np.fft.rfft(np.log(1.0 + 0.05 * np.sin(2.0 * np.pi * t)))
    harmonics = 100.0 * np.arange(len(waves))
    passed = np.fft.irfft(waves / (1.0 + 1j * harmonics / (2.5 * lux)))
    # A turn costs each pixel half a threshold on average, and there are two per period.
    expected = 5 * (np.ptp(passed) / 0.006 - 0.5)
    assert on.sum() / PIXELS == pytest.approx(expected, rel=0.12)
    assert np.mean(on) == pytest.approx(0.5, abs=0.03)


def test_small_ripple_fires_nothing_by_itself():
    lamp = Flicker(0.03, 0.3)
    settings = PixelSettings(0.2, 0.25, **QUIET)
    assert len(events_under(lamp, settings, 100.0, warm_s=0.05)[0]) < 0.1 * PIXELS


def test_pixels_that_rest_fire_as_the_ripple_comes_and_not_when_something_wakes_them():
    settings = PixelSettings(0.2, 0.2, **{**QUIET, 'leak_hz': 0.2})
    lamp = Flicker(0.02, 0.3)
    woken, resting = (
        events_under(lamp, settings, 100.0, 1.2, 1000, touched=touched)
        for touched in (lambda _: True, lambda k: k % 300 == 250)
    )
    times = np.arange(0.1, 1.31, 0.004)
    counts = [np.histogram(each[0], times)[0] for each in (woken, resting)]
    assert counts[0].sum() > 0.1 * PIXELS
    assert counts[1].sum() == pytest.approx(counts[0].sum(), rel=0.02)
    assert counts[1].max() < 1.3 * counts[0].max()


def test_mean_over_an_exposure():
    lamp = Flicker(0.2, 0.1)
    assert lamp.mean(0.0, 10_000.0) == pytest.approx(1.0, abs=1e-4)
    turns = 2.0 * np.pi * 100.0
    first, last = (turns * t + 2.0 * np.pi * 0.1 for t in (0.001, 0.008))
    expected = 1.0 + 0.2 * (np.cos(first) - np.cos(last)) / (turns * 0.007)
    assert lamp.mean(1_000.0, 8_000.0) == pytest.approx(expected, abs=1e-4)
