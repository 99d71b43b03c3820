# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A vibrating contact: the lines in the event rate, and what the pixels' bandwidth takes away."""

import numpy as np
import pytest

from mixtac_sim.mechanics.contact import Mode
from mixtac_sim.pixels.aps import ApsSettings
from mixtac_sim.pixels.biases import PixelSettings
from mixtac_sim.world.effects import EASY
from mixtac_sim.world.profiles import make_profile
from mixtac_sim.world.segments import Profile, Segment, Tone
from mixtac_sim.world.sensor import TactileSensor

QUIET = {'shot_hz': 0.0, 'leak_hz': 0.0, 'leak_hz_per_lux': 0.0}
NO_FRAMES = ApsSettings(first_us=10**9)
EVEN = EASY.without('pixels', 'light', 'timing')


def shake(frequency, settings, preset=EVEN, seconds=0.8):
    """Return the events of the last half second of a press that vibrates by 0.1 mm."""
    press = Segment(0.0, 0.2, Mode.POSITION, (0.0, 0.2), (-0.1, 0.5))
    tone = Tone(0.1, frequency, 0.0, 0.05)
    hold = Segment(0.2, seconds, Mode.POSITION, (0.0,), (0.5,), (tone,))
    profile = Profile('vibration', seconds, (press, hold))
    body = TactileSensor(1, 2, profile, NO_FRAMES, settings, preset=preset)
    return body.advance(round(1e6 * seconds)).events.between(300_000, 800_000)


def lines(events, frequency):
    """Return the pooled rate's lines at the drive and at twice it, over the median of all."""
    counts = np.bincount((events.t - 300_000) // 500, minlength=1000)[:1000]
    spectrum = np.abs(np.fft.rfft(counts - counts.mean()))
    return spectrum[[frequency // 2, frequency]] / np.median(spectrum)


@pytest.fixture(scope='module')
def symmetric():
    settings = PixelSettings(0.2, 0.2, **QUIET)
    return {f: shake(f, settings) for f in (60, 200)}


@pytest.mark.parametrize('frequency', [60, 200])
def test_symmetric_motion_gives_a_line_at_twice_the_drive(symmetric, frequency):
    drive, twice = lines(symmetric[frequency], frequency)
    assert twice > 100.0
    assert twice > 10.0 * drive


def test_imbalance_of_the_thresholds_leaves_the_drive_itself(symmetric):
    even, uneven = symmetric[60], shake(60, PixelSettings(0.2, 0.7, **QUIET))
    drive, twice = lines(uneven, 60)
    even_drive, even_twice = lines(even, 60)
    assert drive / twice > 5.0 * even_drive / even_twice


def test_bandwidth_takes_fast_vibration_away(symmetric):
    without = EVEN.without('bandwidth')
    settings = PixelSettings(0.2, 0.2, **QUIET)
    slow, fast = (len(shake(f, settings, without)) / f for f in (60, 200))
    assert fast == pytest.approx(slow, rel=0.1)  # events per period: the motion is the same
    assert len(symmetric[200]) / 200 < 0.4 * len(symmetric[60]) / 60
    assert len(symmetric[60]) / 60 < slow


def test_named_profile_vibrates_between_50_and_250_hz():
    found = [
        tone.frequency_hz
        for seed in range(20)
        for segment in make_profile('vibration', seed, 10.0).segments
        for tone in segment.tones
    ]
    assert len(found) > 50
    assert 50.0 <= min(found) < 80.0
    assert 220.0 < max(found) <= 250.0


def test_force_follows_the_vibration():
    profile = make_profile('vibration', 3, 3.0)
    body = TactileSensor(1, 2, profile, NO_FRAMES)
    truth = body.advance(2_000_000)
    tone = max((s for s in profile.segments if s.tones), key=lambda s: s.end_s).tones[0]
    wave = truth.wrench[8_000:16_000, 2]
    spectrum = np.abs(np.fft.rfft(wave - wave.mean()))
    assert abs(np.argmax(spectrum[20:]) + 20 - tone.frequency_hz) <= 2.0
