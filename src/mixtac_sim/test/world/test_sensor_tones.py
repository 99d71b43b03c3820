# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Tones up to 450 Hz in the events of a `paper_like` sensor, found by another spectrum."""

import numpy as np
import pytest
from scipy.signal import periodogram

from mixtac_events.arrays import Events
from mixtac_lab.experiments.studies.tones import binned, find_line, shake
from mixtac_sim import SimulationError
from mixtac_sim.pixels.biases import PixelSettings
from mixtac_sim.world.device import draw_device
from mixtac_sim.world.effects import EASY, preset
from mixtac_sim.world.profiles import VIBRATION_DEPTH_MM, VIBRATION_MM, make_profile
from mixtac_sim.world.sensor import TactileSensor

PAPER = preset('paper_like')


@pytest.mark.parametrize('frequency', [70, 230])
@pytest.mark.parametrize('amplitude', [0.05, 0.1])
def test_tones_of_the_paper_stand_in_the_flow(frequency, amplitude):
    found = shake(21, 3, frequency, amplitude, preset=PAPER)
    assert found.flow.peak_hz in {frequency, 2 * frequency}
    assert found.flow.drive > 30.0
    assert found.rate > found.rest_rate


def test_a_tone_at_the_upper_end_stands_in_the_counts_at_twice_its_frequency():
    found = shake(21, 3, 230, 0.1, preset=PAPER)
    assert found.count.peak_hz == pytest.approx(460.0, abs=1.0)
    assert found.count.twice > 30.0


def test_a_tone_above_the_papers_range_stands_in_the_flow():
    assert shake(21, 3, 430, 0.1, preset=PAPER).flow.peak_hz == pytest.approx(430.0, abs=1.0)


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
    with pytest.raises(SimulationError):
        shake(1, 1, 100, 0.5, preset=EASY, depth_mm=0.4)


@pytest.mark.parametrize('seed', range(5))
def test_pixels_are_as_fast_as_a_published_sensor(seed):
    """3 kHz at 1 klx on the scene (Lichtsteiner 2008), f/1.2 to f/2.8, half the photodiode."""
    settings = draw_device(seed, PAPER).pixel_settings(PixelSettings())
    on_chip_lux = [1000.0 * 0.9 * 0.9 / (4.0 * n * n) for n in (1.2, 2.8)]
    slowest, fastest = (0.5 * 3000.0 / lux for lux in on_chip_lux)
    assert 0.9 * slowest < settings.hz_per_lux < fastest


def test_signals_of_known_events():
    """Two events per period, ON to the right of an edge and OFF back: flow swings at the drive."""
    frame = np.tile(np.exp(np.arange(346) / 60.0), (260, 1)).astype(np.uint16) + 1
    t = np.arange(0, 1_000_000, 5_000)  # ON, OFF, ON, ... at 100 Hz
    ones = np.ones(len(t), np.uint16)
    events = Events(t, 300 * ones, 100 * ones, np.arange(len(t)) % 2 == 0)
    counts, balance, flow = binned(events, frame, (0.0, 1.0), 1000)
    assert counts.sum() == len(t)
    assert find_line(counts, 100, 1000).drive < 1e-6 * find_line(balance, 100, 1000).drive
    assert find_line(counts, 100, 1000).peak_hz == 200.0
    np.testing.assert_allclose(np.abs(flow[::5]), np.abs(flow[0]), rtol=1e-2)
    assert np.sign(flow[0]) == -np.sign(flow[5])


def test_tones_beyond_half_the_rate_are_looked_for_where_they_appear():
    wave = np.cos(2.0 * np.pi * 2.0 * 370.0 * np.arange(1000) / 1000.0)
    found = find_line(wave + 1e-3 * np.random.default_rng(1).normal(size=1000), 370, 1000)
    assert found.peak_hz == pytest.approx(260.0)
    assert found.clear
    assert found.twice > 100.0 * found.drive
