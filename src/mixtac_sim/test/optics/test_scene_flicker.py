# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A flickering lamp: what pixels of a known bandwidth make of it, and what frames do."""

import numpy as np
import pytest

from mixtac_sim.grids import PADDED, PIXELS, TILES
from mixtac_sim.optics.scene import Flicker, Scene
from mixtac_sim.pixels.aps import ApsSettings
from mixtac_sim.pixels.biases import PixelSettings, PixelSpread
from mixtac_sim.pixels.dvs import Dvs
from mixtac_sim.world.device import draw_flicker
from mixtac_sim.world.effects import EASY
from mixtac_sim.world.profiles import make_profile
from mixtac_sim.world.sensor import TactileSensor

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


def test_frames_pulse_with_the_ripple_of_their_exposures():
    light = type(EASY.light)(ripple=(0.3, 0.3), hot_pixels=(0, 1))
    chosen = type(EASY)('rippling', light=light)
    body = TactileSensor(
        1, 2, make_profile('idle', 1, 1.0), ApsSettings(2_000, 23_000, 5_000), preset=chosen
    )
    frames = body.advance(300_000).frames
    lamp = draw_flicker(2, light)
    means = np.array([f.intensity.mean() for f in frames])
    lit = np.array([lamp.mean(f.exposure_start_us, f.exposure_end_us) for f in frames])
    assert np.ptp(lit) > 0.3
    dark = 1.06  # DN of dark signal in 2 ms
    np.testing.assert_allclose((means - dark) / lit, np.mean((means - dark) / lit), rtol=0.02)
