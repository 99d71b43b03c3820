# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The pixels under light of known course: thresholds, rates, bandwidth, blind time."""

import numpy as np
import pytest
from scipy.optimize import brentq

from mixtac_sim.grids import PADDED, PIXELS, TILES
from mixtac_sim.optics.scene import ONE, Scene
from mixtac_sim.pixels.biases import PixelSettings, PixelSpread, draw_spread
from mixtac_sim.pixels.dvs import Dvs
from mixtac_sim.pixels.noise import NoiseSource

QUIET = {'leak_hz': 0.0, 'leak_hz_per_lux': 0.0, 'shot_hz': 0.0, 'refractory_us': 0.0}


def even_spread():
    ones = np.ones(PADDED, np.float32)
    dead = ones.copy()
    dead[PIXELS:] = 1e6
    return PixelSpread(dead, dead, ones, np.array([7]), np.array([0.0]))


def cover_for(share):
    """Return the cover under which the light is floor + share * gain."""
    s = brentq(lambda s: 1.0 - 1.0 / (1.0 + s + s**2 / 2 + s**3 / 6) - share, 0.0, 1e3)
    return round(s * ONE)


def flicker(settings, spread, light_at, seconds, step_s, lux=(1.0, 1e4), warm_s=1.0):
    """Return the events (time [s], pixel, ON) of an array under even light of a known course.

    Steps after a warm-up count.
    """
    floor = np.full(PADDED, lux[0], np.float32)
    dvs = Dvs(
        Scene(floor, np.full(PADDED, lux[1], np.float32)),
        spread,
        settings,
        np.random.default_rng(0),
    )
    dirty = np.ones(TILES, np.uint8)
    cover = np.empty(PADDED, np.int32)
    cover[:] = cover_for((light_at(0.0) - lux[0]) / lux[1])
    dvs.settle(cover)
    found = []
    for k in range(round((warm_s + seconds) / step_s)):
        end = (k + 1) * step_s
        cover[:] = cover_for((light_at(end) - lux[0]) / lux[1])
        dirty[:] = 1
        dvs.step(cover, dirty, round(1e9 * k * step_s), round(1e9 * end), 0)
        keys = dvs.take()
        if k * step_s >= warm_s - 0.5 * step_s:
            found.append(keys)
    keys = np.concatenate(found)
    return 1e-9 * (keys >> 18), (keys >> 1) & 0x1FFFF, keys & 1


def test_sinusoidal_light_recovers_the_thresholds():
    settings = PixelSettings(0.2, 0.3, 1e5, 1e3, **QUIET)
    spread = draw_spread(11, 0.1)
    amplitude, seconds = 1.5, 2.0

    def light(t):
        return 1000.0 * np.exp(amplitude * np.sin(2.0 * np.pi * 2.0 * t))

    _, pixel, on = flicker(settings, spread, light, seconds, 2e-3)
    per_pixel = np.bincount(pixel[on == 1], minlength=PADDED)[:PIXELS]
    rises = 2.0 * amplitude * 2.0 * seconds  # log-e climbed by each pixel
    # A turn of the light costs the part of a threshold that was not filled, half on average.
    true = 0.2 * spread.on[:PIXELS]
    found = rises / (per_pixel + 0.0)
    lost = 0.5 * (0.2 * spread.on[:PIXELS] + 0.3 * spread.off[:PIXELS]) * 0.5
    estimate = found * (1.0 - lost / (2.0 * amplitude))
    assert np.median(estimate / true) == pytest.approx(1.0, abs=0.05)
    assert np.corrcoef(found, true)[0, 1] > 0.9


@pytest.mark.parametrize(('lux', 'corner'), [(10.0, 25.0), (100.0, 250.0), (4e4, 500.0)])
def test_bandwidth_grows_with_the_light_up_to_the_source_follower(lux, corner):
    follower = 500.0 if lux > 1e3 else 1e6
    settings = PixelSettings(0.02, 0.02, follower, 2.5, **QUIET)

    def swing(frequency):
        # Flicker of +-20 %: the climb per cycle is the number of events times the threshold.
        def light(t):
            return lux * np.exp(0.2 * np.sin(2.0 * np.pi * frequency * t))

        step = 1.0 / frequency / 40.0
        seconds = 2.0 / frequency
        warm = 2.0 / frequency
        _, _, on = flicker(settings, even_spread(), light, seconds, step, (0.5 * lux, lux), warm)
        return np.sum(on == 1) / PIXELS / 2.0

    gain = swing(corner) / swing(corner / 20.0)
    assert gain == pytest.approx(1.0 / np.sqrt(2.0), abs=0.08)


def test_blind_time_caps_the_rate():
    settings = PixelSettings(0.02, 0.02, 1e6, 1e4, **{**QUIET, 'refractory_us': 2_000.0})
    t, pixel, _ = flicker(
        settings, even_spread(), lambda t: 10.0 * np.exp(8.0 * max(t - 1.0, 0.0)), 0.5, 1e-3
    )
    one = np.sort(t[pixel == 1234])
    assert len(one) > 50
    assert np.diff(one).min() >= 1.99e-3


def test_hot_pixels_fire_at_their_rates():
    spread = PixelSpread(*even_spread()[:3], np.array([50, 60]), np.array([100.0, 300.0]))
    settings = PixelSettings(**QUIET)
    noise = NoiseSource(np.full(PIXELS, 10.0, np.float32), settings, spread, 0.0, 1)
    keys = np.concatenate([noise.block(k, 4_000_000, []) for k in range(2_500)])
    counts = np.bincount((keys >> 1) & 0x1FFFF, minlength=PIXELS)
    assert counts[50] == pytest.approx(1000, rel=0.1)
    assert counts[60] == pytest.approx(3000, rel=0.06)
    assert counts.sum() == counts[50] + counts[60]
