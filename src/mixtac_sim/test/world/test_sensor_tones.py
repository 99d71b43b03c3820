# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The tone of a vibration in the events of a `paper_like` sensor, and the speed of its pixels."""

import numpy as np
import pytest
from scipy.signal import periodogram

from mixtac_sim.pixels.biases import PixelSettings
from mixtac_sim.world.device import draw_device
from mixtac_sim.world.effects import preset
from mixtac_sim.world.gestures import VIBRATION_DEPTH_MM, VIBRATION_MM
from mixtac_sim.world.profiles import make_profile
from mixtac_sim.world.sensor import TactileSensor

PAPER = preset('paper_like')


def test_named_profile_shows_its_tone():
    """A trial of the data set `vibration`, judged by scipy's periodogram of the counts alone."""
    profile = make_profile('vibration', 5, 2.4, preset=PAPER)
    hold = max((s for s in profile.segments if s.tones), key=lambda s: s.end_s - s.start_s)
    events = TactileSensor(22, 5, profile, preset=PAPER).advance(2_400_000).events
    first, last = round(1e6 * hold.start_s) + 60_000, round(1e6 * hold.end_s) - 60_000
    counts = np.histogram(events.t, np.arange(first, last, 1000))[0]
    # Counts of the lamp's lines and of the frames lie at multiples of 25 Hz.
    at_hz, power = periodogram(counts, 1000.0, 'hann')
    beside = np.abs(at_hz / 25.0 - np.round(at_hz / 25.0)) > 0.12
    peak_hz = at_hz[np.argmax(power * beside * (at_hz > 40.0))]
    tone_hz = hold.tones[0].frequency_hz
    assert min(abs(peak_hz - tone_hz), abs(peak_hz - 2.0 * tone_hz)) < 2.0 * at_hz[1]


def test_vibration_keeps_contact():
    assert VIBRATION_MM[1] < VIBRATION_DEPTH_MM[0]


@pytest.mark.parametrize('seed', range(5))
def test_pixels_are_as_fast_as_a_published_sensor(seed):
    """3 kHz at 1 klx on the scene (Lichtsteiner 2008), f/1.2 to f/2.8, half the photodiode."""
    settings = draw_device(seed, PAPER).pixel_settings(PixelSettings())
    on_chip_lux = [1000.0 * 0.9 * 0.9 / (4.0 * n * n) for n in (1.2, 2.8)]
    slowest, fastest = (0.5 * 3000.0 / lux for lux in on_chip_lux)
    assert 0.9 * slowest < settings.hz_per_lux < fastest
