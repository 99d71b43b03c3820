# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Noise events of the pixels against the light, from the dark to bright scenes."""

import numpy as np
import pytest

from mixtac_sim.grids import PADDED, PIXELS, TILES
from mixtac_sim.optics.scene import Scene
from mixtac_sim.pixels.biases import PixelSettings, PixelSpread
from mixtac_sim.pixels.dvs import Dvs
from mixtac_sim.pixels.noise import NoiseSource

LUX = np.array([1.0, 4.0, 16.0, 64.0, 200.0])
SETTINGS = PixelSettings(leak_hz=0.1, leak_hz_per_lux=0.002, shot_hz=8.0, shot_lux=4.0)
ONES = np.ones(PADDED, np.float32)
SPREAD = PixelSpread(ONES, ONES, ONES, np.array([7]), np.array([0.0]))


def rates(lux, blocks=100):
    """Return leak and shot events per second and pixel under even light."""
    floor = np.full(PADDED, lux, np.float32)
    scene = Scene(floor, np.zeros(PADDED, np.float32))
    dvs = Dvs(scene, SPREAD, SETTINGS, np.random.default_rng(int(lux)))
    noise = NoiseSource(floor[:PIXELS], SETTINGS, SPREAD, 0.0, int(lux))
    cover, dirty, ns = np.zeros(PADDED, np.int32), np.zeros(TILES, np.uint8), 20_000_000
    leak = shot = 0
    for k in range(blocks):
        dvs.step(cover, dirty, k * ns, (k + 1) * ns, k * ns)
        leak += len(dvs.take())
        shot += len(noise.block(k, ns, []))
    seconds = 1e-9 * ns * blocks
    return leak / PIXELS / seconds, shot / PIXELS / seconds


@pytest.fixture(scope='module')
def measured():
    return np.array([rates(lux) for lux in LUX]).T


def test_leak_is_a_line_over_the_light(measured):
    slope, dark = np.polyfit(LUX, measured[0], 1)
    assert dark == pytest.approx(0.1, rel=0.05)
    assert slope == pytest.approx(0.002, rel=0.05)


def test_shot_noise_falls_with_the_light_to_half_at_its_constant(measured):
    shot = measured[1]
    np.testing.assert_allclose(shot * (1.0 + LUX / 4.0), 8.0, rtol=0.05)
    assert shot[1] == pytest.approx(4.0, rel=0.05)
    # Dim 10 Hz, good light below 1 Hz: the ratio measured on DAVIS cameras is about 50.
    assert 20.0 < shot[0] / shot[-1] < 80.0
