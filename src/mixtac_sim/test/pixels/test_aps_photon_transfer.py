# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Noise of the frames against their mean: the photon transfer curve of shot and read noise."""

import numpy as np
import pytest

from mixtac_sim.grids import TILE, TILES
from mixtac_sim.pixels.aps import Aps, ApsSettings


def pair(lux):
    """Return two frames under the same even light."""
    aps = Aps(3, int(lux), 1.0, ApsSettings(7_000, 20_000, 5_000))
    light, frames = np.full((TILES, TILE), lux, np.float32), []
    for start in range(0, 60_000, 500):
        aps.expose_before(light, start, start + 500)
        aps.expose_after(light, start, start + 500)
        frame = aps.finish(start + 500, 1.0)
        frames += [frame] if frame is not None else []
    return frames[:2]


@pytest.fixture(scope='module')
def curve():
    """Return mean [DN] and temporal variance [DN^2] of frames from dark to two thirds of full."""
    points = []
    for lux in (1.0, 5.0, 15.0, 30.0, 50.0, 70.0, 95.0):
        first, second = (frame.intensity.astype(np.float64) for frame in pair(lux))
        points.append((0.5 * (first + second).mean(), 0.5 * np.var(first - second)))
    return np.array(points).T


def test_slope_is_the_conversion_gain(curve):
    slope, _ = np.polyfit(*curve, 1)
    assert 1.0 / slope == pytest.approx(34.0, rel=0.05)  # e-/DN


def test_intercept_is_the_read_noise_of_both_samples(curve):
    _, dark = np.polyfit(*curve, 1)
    # Two readings of 55 e- and the steps of two conversions.
    assert dark == pytest.approx(2.0 * (55.0 / 34.0) ** 2 + 2.0 / 12.0, rel=0.06)


def test_dynamic_range_is_that_of_the_specification():
    # Full well over the noise of a dark frame: 56 dB for one reading, 3 dB less for two.
    first, second = (frame.intensity.astype(np.float64) for frame in pair(1.0))
    dark = np.sqrt(0.5 * np.var(first - second))
    assert 20.0 * np.log10(1023.0 / dark) == pytest.approx(53.0, abs=1.5)
